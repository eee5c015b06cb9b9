"""Parameters of `modulated_torque`, and what it takes from a device file beside `transmissions`."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

from via_core.devices import Device

from via_estimators.contract import Parameters, parameter
from via_estimators.spring_series import MOST_TERMS
from via_estimators.transmissions import driving_motors_of

SHORTEST, FEWEST, MOST = 0.1, 20, 400  # [s], and in intervals: windows from a device file
ENERGY = 1.98, 3010.0  # c_0 and c_2 of w_55
RELAXATION = 0.01  # [s] standard deviation of damping over stiffness of a spring: rubber has some milliseconds


@dataclass(frozen=True)
class ModulatedTorqueParameters(Parameters):
    """Parameters of `ModulatedTorque`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals per window", "-", 20, 2000)
    modulating_order: int = parameter(5, "h of the modulating function w_hh", "-", 2, 9)
    order: int = parameter(3, "odd terms of the spring law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms in addition, the constant first", "-", 0, MOST_TERMS)
    preset_terms: int = parameter(0, "odd terms in proportion to the preset theta_2 in addition", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(60.0, "mean time between changes of how fast the spring changes", "s", 0.05, 1e9)
    steadiness: float = parameter(0.5, "probability that a spring does not change; 1: it never does", "-", 0.0, 1.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    friction_prior: float = parameter(0.0, "dry friction of a motor before any data", "N m", 0.0, 1e6)
    friction_deviation: float = parameter(1.0, "standard deviation of the prior dry friction", "N m", 1e-9, 1e6)
    loss_prior: float = parameter(0.0, "damping of a transmission before any data", "N m s/rad", 0.0, 1e4)
    loss_deviation: float = parameter(3.0, "standard deviation of that", "N m s/rad", 1e-9, 1e4)
    delay_deviation: float = parameter(0.003, "standard deviation of the torque's delay before data", "s", 1e-9, 1.0)
    constant_deviation: float = parameter(300.0, "standard deviation of the constant before any data", "N m", 1e-9, 1e9)
    gear_deviation: float = parameter(0.1, "standard deviation of a gear's friction over its load", "-", 1e-9, 1.0)
    creep_deviation: float = parameter(10.0, "standard deviation of the stiffness that relaxes", "N m/rad", 1e-9, 1e9)
    play_deviation: float = parameter(20.0, "standard deviation of the stiffness missing near 0", "N m/rad", 1e-9, 1e9)
    torque_scale_deviation: float = parameter(0.0, "relative standard deviation of the torque's scale", "-", 0.0, 1.0)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


DEFAULTS = ModulatedTorqueParameters()


def loss_of(device: Device, stiffness: float) -> dict[str, float]:
    """Prior of the damping of a transmission: that of its damper, or of a spring of `stiffness` [N m/rad]."""
    of_spring = RELAXATION * stiffness
    if device.damper is None or device.damper.site != "transmission":
        return {"loss_deviation": of_spring}
    least, most = (float(device.damping_of(u)) for u in (0.0, 1.0))
    return {"loss_prior": 0.5 * (least + most), "loss_deviation": max(most, of_spring)}


def window_for(known: dict[str, Any], device: Device) -> int:
    """Sampling intervals of the shortest window in which torque noise exceeds that of the encoders five times.

    A longer window delays the estimate and hides motion, a shorter one adds encoder noise through psi''. The variances
    are proportional to c_0 torque_noise^2 / T and c_2 (B position_noise)^2 / T^5, c_i = T^(2i+1) <psi^(i), psi^(i)>.
    """
    heaviest = max(motor.inertia for motor in driving_motors_of(device))
    balance = heaviest * known["position_noise"] / known["torque_noise"]
    span = max(SHORTEST, sqrt(balance) * (5.0 * ENERGY[1] / ENERGY[0]) ** 0.25)
    return int(min(max(round(span * device.sensors.rate), FEWEST), MOST))
