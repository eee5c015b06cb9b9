"""Baseline with a known motor: a residual observes the flexibility torque, recursive least squares fit the spring law.

Source: F. Flacco, A. De Luca, I. Sardellitti, N. Tsagarakis (2012), the document's reference [9], as described in the
SAPHARI deliverable, Sections 4 and 5.1 (stability factor (71)-(73)). With nominal inertia B and damping D

    the residual  r = K (B thd - integral (tau - D thd + r) ds)   obeys   r' = K (tau_e - r)

for tau_e = B thdd + D thd - tau: it is the flexibility torque after a low pass of bandwidth K, without accelerations.
Velocity and deflection come from kinematic Kalman filters, modified for quantised encoders (`kinematic_kalman`); no
velocity sensor is needed. Then r = sum_j a_j f_j(phi), by plain recursive least squares from a large P, without
forgetting.

Departure: the f_j pass the same low pass; otherwise the residual's lag 1/K would bias the result and distort a
comparison of methods. Torques act over the interval that ends at their stamp.

The residual is linear in its signals and is computed in three parts, r = B r_B + D r_D - r_tau, each with its own
solution and the same gains. This gives the sensitivity of the spring law to errors of B and D. Standard deviations
include it for the declared tolerances, of one motor independent of the other's. They are too small where B or D have
larger errors, 2-8 times too large on simulated qbmoves whose motors are exactly nominal, and up to half too large for
motor errors equal to the tolerances, probably because such errors also increase the noise measured in the innovations.
That noise is the long-run variance of innovations, from means over windows, since encoder noise after the Kalman
filters is far from white. Not included: the truncation of the basis, drift of the spring law, and errors in the
regressors except for that of the present deflection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import kinematic_kalman as kalman
from via_estimators import rls, transmissions, window
from via_estimators.basis import BASES, MOST_TERMS, fill_basis
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter
from via_estimators.signal_based import SignalBased
from via_estimators.slots import slots
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
CONVERGED = 10.0  # time constants 1/K until the initial value of a low pass is negligible
P = slots(
    "length", "transmissions", "basis", "terms", "bandwidth", "stability", "max_gap", "deflection_scale",
    "torque_noise", "minimum_motion", "range_margin", "inertia", "damping", "inertia_tolerance", "damping_tolerance",
    "stiffness_prior", "stiffness_deviation",
)  # fmt: skip
# Of a transmission: rows taken; time since the start [s]; last velocity; low-passed velocity and torque; sum and number
# of innovations in the current mean; means taken and the sum of their squares. Followed, per term, by the low-passed f,
# the last f, the solutions w of the PARTS and P.
KEPT = slots(
    "taken", "age", "velocity", "slow_velocity", "slow_torque", "sum", "count", "means", "power", after=VISITED
)
PARTS = 3  # r_B, r_D, r_tau


@dataclass(frozen=True)
class ResidualParameters(Parameters):
    """Parameters of `Residual`; inertia and damping are given, not estimated."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals for range of motion and mean of noise", "-", 20, 2000)
    basis: str = choice("odd_powers", "basis functions of the spring law", tuple(BASES))
    terms: int = parameter(4, "number of basis functions", "-", 1, MOST_TERMS)
    bandwidth: float = parameter(100.0, "gain K of the residual", "1/s", 1e-2, 1e5)
    stability: float = parameter(1.0, "stability factor c of the recursion; 1: plain", "-", 1e-6, 1e6)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the residual", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia: float = parameter(0.02, "nominal motor inertia B", "kg m^2", 0.0, 1e3)
    inertia_tolerance: float = parameter(0.0, "standard deviation of the nominal inertia", "kg m^2", 0.0, 1e3)
    damping: float = parameter(0.1, "nominal motor damping D", "N m s/rad", 0.0, 1e4)
    damping_tolerance: float = parameter(0.0, "standard deviation of the nominal damping", "N m s/rad", 0.0, 1e4)
    inertia_2: float = parameter(0.02, "that of motor 2", "kg m^2", 0.0, 1e3)
    inertia_tolerance_2: float = parameter(0.0, "standard deviation of that", "kg m^2", 0.0, 1e3)
    damping_2: float = parameter(0.1, "damping of motor 2", "N m s/rad", 0.0, 1e4)
    damping_tolerance_2: float = parameter(0.0, "standard deviation of that", "N m s/rad", 0.0, 1e4)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-12, 1e9)
    acceleration: float = parameter(20.0, "sqrt(V_a) of the Kalman filters of angles", "rad/s^2", 1e-3, 1e9)
    quantum: float = parameter(0.0, "step of the encoders; 0: plain Kalman filter", "rad", 0.0, 0.1)
    position_noise: float = parameter(3e-5, "standard deviation of angle noise before quantisation", "rad", 1e-12, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class Residual(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, inertia and damping given."""

    parameters: ResidualParameters = ResidualParameters()

    @classmethod
    def from_device(cls, device: Device) -> Residual:
        """Nominal motor and scales from a device file; inertia is assumed good to 5 %, damping to 10 %."""
        like = SignalBased.from_device(device).parameters
        shared = (
            "transmissions", "deflection_scale", "stiffness_prior", "stiffness_deviation", "torque_noise",
            "minimum_motion", "range_margin", "basis", "terms",
        )  # fmt: skip
        return cls(
            ResidualParameters(
                **{name: getattr(like, name) for name in shared},
                **transmissions.encoders_of(device),
                **transmissions.given_motors_of(device, 0.05, 0.1),
            )
        )

    def with_parameters(self, parameters: Parameters) -> Residual:
        return replace(self, parameters=expect(parameters, ResidualParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter rows of the motors (m, ..) and of Kalman filters; writable, since a locked array compiles again."""
        own = self.parameters
        rows = transmissions.of_each_motor(P, own, length=own.window + 1, basis=BASES[own.basis])
        return np.stack(rows), kalman.parameter_row(own)

    @property
    def _each(self) -> int:
        """Numbers in the state of one transmission."""
        terms = self.parameters.terms
        return KEPT.size + terms * (2 + PARTS) + terms * terms

    def init(self) -> Array:
        own, k = self.parameters, len(self.outputs)
        m, length = own.transmissions, own.window + 1
        state = np.zeros(HEADER.size + 2 * k + length * (1 + m) + (1 + m) * kalman.F.size + m * self._each)
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(own)
        for P_i in self._covariances(state):
            P_i[:, :] = np.eye(own.terms)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        return max(float(np.linalg.cond(P_i)) for P_i in self._covariances(state))

    def _covariances(self, state: Array) -> list[Array]:
        """The views P (terms, terms) of the transmissions."""
        m, terms = self.parameters.transmissions, self.parameters.terms
        parts = state[len(state) - m * self._each :].reshape(m, -1)
        return [part[-terms * terms :].reshape(terms, terms) for part in parts]

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _low_pass(x: float) -> tuple[float, float, float]:
    """Weights of the last output, the last input and this input, linear in between; x = K times the step."""
    stays = exp(-x)
    mean = (1.0 - stays) / x if x > 1e-6 else 1.0 - 0.5 * x
    return stays, mean - stays, 1.0 - mean


@njit(cache=True, error_model="numpy", forceinline=True)
def _views(part: Array, terms: int) -> tuple[Array, Array, Array, Array]:
    """The views of a transmission's low-passed f (terms,), last f (terms,), w (PARTS, terms) and P (terms, terms)."""
    at = KEPT.size
    w = part[at + 2 * terms : at + terms * (2 + PARTS)].reshape(PARTS, terms)
    P_i = part[at + terms * (2 + PARTS) :].reshape(terms, terms)
    return part[at : at + terms], part[at + terms : at + 2 * terms], w, P_i


@njit(cache=True, error_model="numpy", forceinline=True)
def _filter(par: Array, part: Array, f: Array, velocity: float, torque: float, elapsed: float, restarted: bool) -> None:
    """Advance the low passes of velocity, torque and f (terms,) by `elapsed` [s]."""
    terms = f.size
    slow, last = part[KEPT.size : KEPT.size + terms], part[KEPT.size + terms : KEPT.size + 2 * terms]
    if restarted:
        part[KEPT.age], part[KEPT.slow_velocity], part[KEPT.slow_torque] = 0.0, velocity, torque
        slow[:] = f
    else:
        stays, earlier, later = _low_pass(par[P.bandwidth] * elapsed)
        part[KEPT.slow_velocity] = stays * part[KEPT.slow_velocity] + earlier * part[KEPT.velocity] + later * velocity
        part[KEPT.slow_torque] = stays * part[KEPT.slow_torque] + (earlier + later) * torque
        for j in range(terms):
            slow[j] = stays * slow[j] + earlier * last[j] + later * f[j]
        part[KEPT.age] += elapsed
    part[KEPT.velocity] = velocity
    last[:] = f


@njit(cache=True, error_model="numpy", forceinline=True)
def _fit(par: Array, part: Array, velocity: float, parts: Array, row: Array, gain: Array) -> None:
    """Add one row to the three solutions, which share the gain; the innovation of their sum updates the noise.

    parts, row, gain  (PARTS,), (terms,), (terms,) overwritten
    """
    terms, unit = row.size, par[P.torque_noise]
    slow, _, w, P_i = _views(part, terms)
    parts[0], parts[1] = par[P.bandwidth] * (velocity - part[KEPT.slow_velocity]), part[KEPT.slow_velocity]
    parts[2] = part[KEPT.slow_torque] + par[P.stiffness_prior] * slow[0]  # the prior spring torque is subtracted
    innovation = 0.0
    for j in range(terms):
        row[j] = slow[j] * par[P.stiffness_deviation] / unit
    for k in range(PARTS):
        y = parts[k] / unit
        if k == 0:
            left = rls.update(P_i, w[0], row, y, par[P.stability], gain)
        else:
            left = y
            for j in range(terms):
                left -= row[j] * w[k, j]
            for j in range(terms):
                w[k, j] += gain[j] * left
        innovation += left * (par[P.inertia] if k == 0 else par[P.damping] if k == 1 else -1.0)
    part[KEPT.taken] += 1.0
    part[KEPT.sum] += innovation
    part[KEPT.count] += 1.0
    if part[KEPT.count] >= par[P.length] - 1.0:
        part[KEPT.power] += part[KEPT.sum] * part[KEPT.sum] / part[KEPT.count]
        part[KEPT.means] += 1.0
        part[KEPT.sum] = part[KEPT.count] = 0.0


@njit(cache=True, error_model="numpy", forceinline=True)
def _evaluate(par: Array, part: Array, g: Array, bend: Array, warming: bool) -> tuple[float, float, float]:
    """Stiffness [N m/rad], its derivative by phi and its variance; g and bend are the basis' first two derivatives."""
    terms, width = g.size, par[P.stiffness_deviation]
    _, _, w, P_i = _views(part, terms)
    noise = (
        par[P.stability] * (1.0 + part[KEPT.power]) / (1.0 + part[KEPT.means])
    )  # with c, P is that of c P(0), over c
    stiffness, slope, uncertain, by_inertia, by_damping = par[P.stiffness_prior], 0.0, 0.0, 0.0, 0.0
    for j in range(terms):
        share = 0.0 if warming else par[P.inertia] * w[0, j] + par[P.damping] * w[1, j] - w[2, j]
        stiffness += width * share * g[j]
        slope += width * share * bend[j]
        by_inertia += w[0, j] * g[j]
        by_damping += w[1, j] * g[j]
        for o in range(terms):
            uncertain += g[j] * ((1.0 if j == o else 0.0) if warming else noise * P_i[j, o]) * g[o]
    if not warming:
        uncertain += (par[P.inertia_tolerance] * by_inertia) ** 2 + (par[P.damping_tolerance] * by_damping) ** 2
    return stiffness, slope, width**2 * max(uncertain, 0.0)


@njit(cache=True, error_model="numpy")
def _advance(each: Array, kinematic: Array, state: Array, rows: Array, out: Array) -> int:
    par = each[0]  # that of motor 1; all rows agree but in inertia and damping
    length, m, terms = int(par[P.length]), int(par[P.transmissions]), int(par[P.terms])
    value, sd = window.outputs(state, 1 + m)
    at = HEADER.size + 2 * value.size
    times, ring = window.rings(state, at, length, m)  # deflections
    at += length * (1 + m)
    filters = state[at : at + (1 + m) * kalman.F.size].reshape(1 + m, kalman.F.size)
    parts = state[at + (1 + m) * kalman.F.size :].reshape(m, -1)
    f, g, bend, row, gain = np.empty(terms), np.empty(terms), np.empty(terms), np.empty(terms), np.empty(terms)
    residuals, joint = np.empty(PARTS), np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        before = state[HEADER.last]
        entered = transmissions.enter(state, times, rows[k], 2, FURTHEST * par[P.deflection_scale], par[P.max_gap])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, full = int(state[HEADER.slot]), state[HEADER.filled] == length
        elapsed, restarted = max(rows[k, 0] - before, 0.0), entered == window.RESTARTED
        kalman.follow(kinematic, filters, rows[k], elapsed, restarted)
        link = filters[0]
        transmissions.begin(joint)
        for i in range(m):
            part, motor = parts[i], filters[1 + i]
            phi, velocity = link[kalman.F.angle] - motor[kalman.F.angle], motor[kalman.F.velocity]
            ring[i, slot] = phi
            swing = window.span_of(ring[i]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], swing)
            fill_basis(int(par[P.basis]), phi, par[P.deflection_scale], f, g, bend)
            _filter(each[i], part, f, velocity, rows[k, 3 + 2 * i], elapsed, restarted)
            converged = par[P.bandwidth] * part[KEPT.age] >= CONVERGED
            moving = full and swing >= par[P.minimum_motion] and converged
            if moving:
                _fit(each[i], part, velocity, residuals, row, gain)
                transmissions.visit(part, phi)
            warming = part[KEPT.taken] < length
            stiffness, slope, uncertain = _evaluate(each[i], part, g, bend, warming)
            found = sqrt(uncertain + slope * slope * (link[kalman.F.p_xx] + motor[kalman.F.p_xx]))
            transmissions.update(value, sd, 1 + i, stiffness, found, warming or moving)
            transmissions.add(joint, stiffness, sd[1 + i], slope, link[kalman.F.p_xx], 0.0)
            transmissions.grade(joint, warming, moving, transmissions.inside(part, phi, par[P.range_margin]))
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
