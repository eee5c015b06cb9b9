"""Parameters of `unknown_input_observer`."""

from __future__ import annotations

from dataclasses import dataclass

from via_estimators.basis import BASES, MOST_TERMS
from via_estimators.contract import Parameters, choice, parameter


@dataclass(frozen=True)
class UnknownInputObserverParameters(Parameters):
    """Parameters of `UnknownInputObserver`; inertia and damping are given, not estimated."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(100, "sampling intervals per reconstruction of the torque", "-", 4, 2000)
    basis: str = choice("odd_powers", "basis functions of the spring law", tuple(BASES))
    terms: int = parameter(4, "number of basis functions", "-", 1, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(20.0, "time after which an equation has weight 1/e", "s", 1e-3, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    friction_prior: float = parameter(0.0, "dry friction of a motor before any data", "N m", 0.0, 1e6)
    friction_deviation: float = parameter(1.0, "standard deviation of the prior dry friction", "N m", 1e-9, 1e6)
    hysteresis_deviation: float = parameter(0.1, "standard deviation of the friction inside a spring", "N m", 1e-9, 1e6)
    delay_deviation: float = parameter(0.003, "standard deviation of the torque's delay", "s", 1e-9, 1.0)
    inertia: float = parameter(0.02, "motor inertia B", "kg m^2", 1e-9, 1e3)
    inertia_tolerance: float = parameter(0.0, "standard deviation of the motor inertia", "kg m^2", 0.0, 1e3)
    damping: float = parameter(0.1, "motor damping D", "N m s/rad", 0.0, 1e4)
    damping_tolerance: float = parameter(0.0, "standard deviation of the motor damping", "N m s/rad", 0.0, 1e4)
    inertia_2: float = parameter(0.02, "that of motor 2", "kg m^2", 1e-9, 1e3)
    inertia_tolerance_2: float = parameter(0.0, "standard deviation of that", "kg m^2", 0.0, 1e3)
    damping_2: float = parameter(0.1, "damping of motor 2", "N m s/rad", 0.0, 1e4)
    damping_tolerance_2: float = parameter(0.0, "standard deviation of that", "N m s/rad", 0.0, 1e4)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


DEFAULTS = UnknownInputObserverParameters()
