"""Stiffness by QR-RLS on the motor equation integrated in time; no model is needed.

Source: SAPHARI deliverable, Section 4.1, eqs. (36)-(49); `integral` states the equation, the corrections to the printed
one and how its base moves. Inertia B, damping D and the coefficients of the spring law are unknowns. Besides angles and
torques, the estimator needs the measured velocity of the motor; `filtered_signal_based` computes it from the angles.

Integration: the effort of a sample is the torque that acted over the interval that ends at its stamp, as in
`modulated_torque`, so its integral is exact; f_j(phi) is a sampled curve, integrated by trapezoids.

Standard deviations include torque noise and velocity noise, both measured; the prior, as wide as its coefficients found
so far indicate (`integral.prior_variance`); and the truncation of the basis: the error per unit of the first omitted
term follows from the data (`integral.considered`), its size is extrapolated from the coefficients
(`integrated_equation.first_omitted`). If the basis is exact, that is too much. Not included: drift of the spring law
within the memory, dry friction, and errors of the angles except for that of the newest sample in g(phi).

No integral is longer than `horizon`; then the next one begins with a new constant, and the information of the last one
is kept. Rows far from their base carry the random walk in between and yet have full weight, so short integrals are also
more accurate: in noise, the error of stiffness is ten times smaller than with integrals from the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import integral, integrated_equation, transmissions, window
from via_estimators.basis import BASES, MOST_TERMS, fill_basis
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter
from via_estimators.integrated_equation import FURTHEST, KEPT, N_ESTIMATE, E, P
from via_estimators.transmissions import JOINT
from via_estimators.window import HEADER


@dataclass(frozen=True)
class SignalBasedParameters(Parameters):
    """Parameters of `SignalBased`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals over which motion is measured", "-", 20, 2000)
    basis: str = choice("odd_legendre", "basis functions of the spring law", tuple(BASES))
    terms: int = parameter(4, "number of basis functions", "-", 1, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over that expected; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(20.0, "time after which a row has weight 1/e", "s", 1e-3, 1e9)
    horizon: float = parameter(1.0, "longest integral before a new one begins", "s", 1e-3, 1e9)
    max_gap: float = parameter(0.05, "longest step between samples to integrate over", "s", 1e-4, 10.0)
    sampling: float = parameter(1e-3, "expected sampling interval", "s", 1e-5, 1.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-12, 1e9)
    velocity_noise: float = parameter(0.0, "expected standard deviation of one velocity sample", "rad/s", 0.0, 1e3)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class SignalBased(Estimator):
    """Stiffness of one or two transmissions from motor torques, motor velocities and angles on both sides."""

    parameters: SignalBasedParameters = SignalBasedParameters()

    @classmethod
    def from_device(cls, device: Device) -> SignalBased:
        """Scales and priors of the order of magnitude that the device file states."""
        odd = all(spring.odd for spring in device.springs)
        return cls(
            SignalBasedParameters(
                **transmissions.priors_of(device),
                **transmissions.known_of(device),
                basis="odd_legendre" if odd else "legendre",
                terms=4 if odd else 7,
                sampling=1.0 / device.sensors.rate,
            )
        )

    def with_parameters(self, parameters: Parameters) -> SignalBased:
        return replace(self, parameters=expect(parameters, SignalBasedParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        each = range(1, self.parameters.transmissions + 1)
        return ("q", *(f"{name}_{i}" for i in each for name in ("theta", "theta_velocity", "tau")))

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; writable, since a locked array compiles again."""
        return integrated_equation.parameter_row(self.parameters)

    def init(self) -> Array:
        rings = (self.parameters.window + 1) * (1 + self.parameters.transmissions)
        return integrated_equation.initial_state(self.parameters, rings, 0, 0)

    def condition(self, state: Array) -> float:
        return integrated_equation.condition(self.parameters, state, 0, 0)

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy", forceinline=True)
def _learn(
    par: Array, colour: Array, part: Array, equation: Array, elapsed: float, keep: float, moving: bool,
    phi: float, motor: Array, basis: Array, work: Array,
) -> None:  # fmt: skip
    """Add one sample to the equation: deflection phi [rad]; motor (3,) = angle, velocity, torque."""
    if moving:
        fill_basis(int(par[P.basis]), phi, par[P.deflection_scale], basis[0], basis[1], basis[2])
    integrated_equation.learn(
        par, colour, part, equation, elapsed, keep, moving, motor[0], motor[1], motor[2], basis[0], work
    )
    if moving:
        transmissions.visit(part, phi)


@njit(cache=True, error_model="numpy", forceinline=True)
def _evaluate(par: Array, part: Array, equation: Array, phi: float, warming: bool, found: Array, work: Array) -> None:
    """Estimates at the deflection phi [rad] into found (N_ESTIMATE,), with the noise measured so far."""
    n = int(par[P.terms]) + 3
    inertia = par[P.size + 1] + par[P.size + n + 1] * integral.unknowns(equation, n)[1]
    declared = 2.0 * (inertia * par[P.velocity_noise] / (par[P.sampling] * par[P.torque_noise])) ** 2
    torque, taken_back = integral.noise(equation, n, declared)
    integrated_equation.evaluate(par, part, equation, warming, phi, torque, taken_back, found, work)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, terms = int(par[P.length]), int(par[P.transmissions]), int(par[P.terms])
    cut = integrated_equation.omitted(int(par[P.basis]))
    value, sd = window.outputs(state, 1 + 3 * m)
    at = HEADER.size + 2 * value.size
    times, ring = window.rings(state, at, length, m)  # deflections
    parts = state[at + length * (1 + m) :].reshape(m, -1)
    own, blur = KEPT.size + terms + cut, par[P.position_noise] ** 2
    joint, found = np.empty(JOINT.size), np.empty(N_ESTIMATE)
    work, basis, white = integrated_equation.scratch(terms + 3 + cut), np.empty((3, terms + cut)), np.ones((1, 1))
    for k in range(rows.shape[0]):
        before = state[HEADER.last]
        entered = transmissions.enter(state, times, rows[k], 3, FURTHEST * par[P.deflection_scale], par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, full = int(state[HEADER.slot]), state[HEADER.filled] == length
        elapsed = max(rows[k, 0] - before, 0.0) if state[HEADER.samples] > 1.0 else 0.0
        keep = exp(-elapsed / par[P.memory])  # also for the time in a gap or before the window is full
        transmissions.begin(joint)
        for i in range(m):
            part, motor = parts[i], rows[k, 2 + 3 * i : 5 + 3 * i]
            equation = part[own:]
            phi = rows[k, 1] - motor[0]
            ring[i, slot] = phi
            swing = window.span_of(ring[i]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], swing)
            moving = full and swing >= par[P.minimum_motion]
            _learn(par, white, part, equation, elapsed, keep, moving, phi, motor, basis, work)
            warming = equation[integral.HEAD.taken] < length
            _evaluate(par, part, equation, phi, warming, found, work)
            noise = 2.0 * (found[E.slope] * par[P.position_noise]) ** 2
            integrated_equation.report(found, i, noise, blur, warming or moving, value, sd, joint)
            transmissions.grade(joint, warming, moving, transmissions.inside(part, phi, par[P.range_margin]))
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
