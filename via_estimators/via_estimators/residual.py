"""The baseline that knows its motor: a residual follows the flexibility torque, recursive least squares fit the law.

Source: F. Flacco, A. De Luca, I. Sardellitti, N. Tsagarakis (2012), the document's reference [9], as the SAPHARI
deliverable tells it in Sections 4 and 5.1 (stability factor (71)-(73)). With nominal inertia B and damping D

    the residual  r = K (B thd - integral (tau - D thd + r) ds)   obeys   r' = K (tau_e - r)

for tau_e = B thdd + D thd - tau: it is the flexibility torque behind a low pass of bandwidth K, without accelerations.
The velocity is that of a kinematic Kalman filter of theta, modified for quantised encoders, and so is the deflection
(`kinematic_kalman`); no velocity sensor is needed. Then r = sum_j a_j f_j(phi), by plain recursive least squares from a
large P, without forgetting.

Departure: the f_j pass the same low pass, lest the residual's lag 1/K be an error of the law that has no business in a
comparison of methods. Torques act over the interval that ends at their stamp.

Being linear in its signals the residual is kept in three parts, r = B r_B + D r_D - r_tau, with a solution of its own
for each: the gains are the same. That tells what a wrong B or D does to the law, and standard deviations hold it for
the declared tolerances, of one motor regardless of the other's: where B or D are wrong by more, they are too small;
where a simulated motor is exactly nominal, 2-8 times too large on the qbmoves, which nobody told the estimator. With
motors wrong by just the tolerances they are up to half too large, probably because what a wrong motor leaves in the
innovations counts as noise besides. The noise is measured as the
long-run variance of innovations, by means over windows, for what the Kalman filters leave of the encoders' noise is far
from white. Left out: what the basis cuts off, drift of the law, and errors in the regressors but for the present
deflection's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import Status

from via_estimators import kinematic_kalman as kalman
from via_estimators import rls, transmissions, window
from via_estimators.basis import BASES, MOST_TERMS, fill_basis
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter
from via_estimators.signal_based import ANY, BEYOND, SignalBased, visit, visited

SETTLED = 10.0  # time constants 1/K until a low pass has forgotten where it started
FASTEST = 10.0  # [rad/s] standard deviation of a velocity not known yet
LENGTH, TRANSMISSIONS, KIND, TERMS, BANDWIDTH, STABILITY, MAX_GAP, SCALE, TORQUE_NOISE, MINIMUM_MOTION = range(10)
MARGIN, INERTIA, DAMPING, INERTIA_TOLERANCE, DAMPING_TOLERANCE, STIFFNESS, DEVIATION = range(10, 17)
ACCELERATION, QUANTUM, WHITE, SIZE = range(17, 21)
# Of a transmission: deflections visited as in signal_based, rows taken, time since the start, last velocity, low-passed
# velocity and torque, sum and number of innovations in the present mean, means taken and their squares; then, per term,
# the low-passed f, the last f, and the solutions of the three parts; then P.
TAKEN, AGE, VELOCITY, SPEED, PUSH, SUM, COUNT, MEANS, POWER, KEPT = range(ANY + 1, ANY + 11)
PARTS = 3  # r_B, r_D, r_tau
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class ResidualParameters(Parameters):
    """Parameters of `Residual`; inertia and damping are what it believes, not what it finds."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(200, "sampling intervals over which motion is judged and noise averaged", "-", 20, 2000)
    basis: str = choice("odd_powers", "functions that make up the torque law", tuple(BASES))
    terms: int = parameter(4, "number of them", "-", 1, MOST_TERMS)
    bandwidth: float = parameter(100.0, "gain K of the residual", "1/s", 1e-2, 1e5)
    stability: float = parameter(1.0, "stability factor c of the recursion; 1: plain", "-", 1e-6, 1e6)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the residual", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which the terms of the law count alike", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of that", "N m/rad", 1e-6, 1e9)
    inertia: float = parameter(0.02, "nominal motor inertia B", "kg m^2", 0.0, 1e3)
    inertia_tolerance: float = parameter(0.0, "standard deviation of that", "kg m^2", 0.0, 1e3)
    damping: float = parameter(0.1, "nominal motor damping D", "N m s/rad", 0.0, 1e4)
    damping_tolerance: float = parameter(0.0, "standard deviation of that", "N m s/rad", 0.0, 1e4)
    torque_noise: float = parameter(0.1, "standard deviation of torque noise expected", "N m", 1e-12, 1e9)
    acceleration: float = parameter(20.0, "sqrt(V_a) of the Kalman filters of angles", "rad/s^2", 1e-3, 1e9)
    quantum: float = parameter(0.0, "step of the encoders; 0: plain Kalman filter", "rad", 0.0, 0.1)
    position_noise: float = parameter(3e-5, "white noise of one angle sample before that", "rad", 1e-12, 0.1)
    minimum_motion: float = parameter(0.01, "range of deflection below which a window tells nothing", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "share of the visited range that counts as visited beyond it", "-", 0.0, 1.0)


@dataclass(frozen=True)
class Residual(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, inertia and damping given."""

    parameters: ResidualParameters = ResidualParameters()

    @classmethod
    def from_device(cls, device: Device) -> Residual:
        """Nominal motor and scales from a device file; the motor's numbers are taken to be good to 5 and 10 %."""
        like = SignalBased.from_device(device).parameters
        shared = (
            "transmissions", "deflection_scale", "stiffness_prior", "stiffness_deviation", "torque_noise",
            "minimum_motion", "range_margin", "basis", "terms",
        )  # fmt: skip
        quantum = max(device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0)
        return cls(
            ResidualParameters(
                **{name: getattr(like, name) for name in shared},
                inertia=like.inertia_prior,
                inertia_tolerance=0.05 * like.inertia_prior,
                damping=like.damping_prior,
                damping_tolerance=0.1 * like.damping_prior,
                quantum=quantum,
                position_noise=max(0.1 * quantum, 1e-9),
            )
        )

    def having(self, parameters: Parameters) -> Residual:
        return replace(self, parameters=expect(parameters, ResidualParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions)

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; not locked, which would be another type to compile."""
        own = self.parameters
        return np.array([
            own.window + 1, own.transmissions, BASES[own.basis], own.terms, own.bandwidth, own.stability, own.max_gap,
            own.deflection_scale, own.torque_noise, own.minimum_motion, own.range_margin, own.inertia, own.damping,
            own.inertia_tolerance, own.damping_tolerance, own.stiffness_prior, own.stiffness_deviation,
            own.acceleration**2, own.quantum, own.position_noise**2,
        ])  # fmt: skip

    @property
    def _each(self) -> int:
        """Floats in the state of one transmission."""
        terms = self.parameters.terms
        return KEPT + terms * (2 + PARTS) + terms * terms

    def init(self) -> Array:
        own = self.parameters
        m, length, k = own.transmissions, own.window + 1, len(self.outputs)
        state = np.zeros(window.HEADER + 2 * k + length * (1 + m) + (1 + m) * kalman.SIZE + m * self._each)
        window.start(state)
        held = (m * own.stiffness_prior, *(m * (own.stiffness_prior,)))
        doubt = (sqrt(m) * own.stiffness_deviation, *(m * (own.stiffness_deviation,)))
        state[window.HEADER : window.HEADER + 2 * k] = (*held, *doubt)
        for i in range(m):
            self._covariance(state, i)[:, :] = np.eye(own.terms)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        return max(float(np.linalg.cond(self._covariance(state, i))) for i in range(self.parameters.transmissions))

    def _covariance(self, state: Array, i: int) -> Array:
        """The view P (m, m) of transmission i, i from 0."""
        terms = self.parameters.terms
        end = len(state) - (self.parameters.transmissions - 1 - i) * self._each
        return state[end - terms * terms : end].reshape(terms, terms)

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def _low_pass(x: float) -> tuple[float, float, float]:
    """Weights of the last output, the last input and this input, which a straight line joins; x = K times the step."""
    stays = exp(-x)
    mean = (1.0 - stays) / x if x > 1e-6 else 1.0 - 0.5 * x
    return stays, mean - stays, 1.0 - mean


@njit(cache=True, error_model="numpy")
def _fit(par: Array, kept: Array, w: Array, P: Array, regressors: Array, parts: Array, row: Array, gain: Array) -> None:
    """One row into the three solutions w (3, m), which share the gain; the innovation of their sum into the noise."""
    terms, unit = row.size, par[TORQUE_NOISE]
    B, D = par[INERTIA], par[DAMPING]
    innovation = 0.0
    for j in range(terms):
        row[j] = regressors[j] * par[DEVIATION] / unit
    for part in range(PARTS):
        y = parts[part] / unit
        if part == 0:
            left = rls.update(P, w[0], row, y, par[STABILITY], gain)
        else:
            left = y
            for j in range(terms):
                left -= row[j] * w[part, j]
            for j in range(terms):
                w[part, j] += gain[j] * left
        innovation += left * (B if part == 0 else D if part == 1 else -1.0)
    kept[TAKEN] += 1.0
    kept[SUM] += innovation
    kept[COUNT] += 1.0
    if kept[COUNT] >= par[LENGTH] - 1.0:
        kept[POWER] += kept[SUM] * kept[SUM] / kept[COUNT]
        kept[MEANS] += 1.0
        kept[SUM] = kept[COUNT] = 0.0


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, kind, terms = int(par[LENGTH]), int(par[TRANSMISSIONS]), int(par[KIND]), int(par[TERMS])
    outputs, scale = 1 + m, par[SCALE]
    at = window.HEADER
    now, spread = state[at : at + outputs], state[at + outputs : at + 2 * outputs]
    at += 2 * outputs
    times = state[at : at + length]
    at += length
    ring = state[at : at + length * m].reshape(m, length)  # deflections
    at += length * m
    filters = state[at : at + (1 + m) * kalman.SIZE].reshape(1 + m, kalman.SIZE)
    at += (1 + m) * kalman.SIZE
    each = KEPT + terms * (2 + PARTS) + terms * terms
    f, g, bend, row, gain = np.empty(terms), np.empty(terms), np.empty(terms), np.empty(terms), np.empty(terms)
    parts = np.empty(PARTS)
    for k in range(rows.shape[0]):
        before = state[window.LAST]
        entered = transmissions.enter(state, times, rows[k], m, BEYOND * scale, par[MAX_GAP])
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, q = int(state[window.SLOT]), rows[k, 1]
        full = state[window.FILLED] == length
        elapsed = max(rows[k, 0] - before, 0.0)
        for i in range(1 + m):
            reading = q if i == 0 else rows[k, 2 * i]
            if entered == window.RESTARTED:
                kalman.start(filters[i], reading, par[WHITE] + par[QUANTUM] ** 2 / 12.0, FASTEST)
                continue
            kalman.predict(filters[i], elapsed, par[ACCELERATION])
            if par[QUANTUM] > 0.0:
                kalman.correct_quantised(filters[i], reading, par[QUANTUM], par[WHITE])
            else:
                kalman.correct(filters[i], reading, par[WHITE])
        link = filters[0]
        worst, motion, total, doubt, bends = OK, np.inf, 0.0, 0.0, 0.0
        for i in range(m):
            own = state[at + i * each : at + (i + 1) * each]
            kept, regressors, last = own[:KEPT], own[KEPT : KEPT + terms], own[KEPT + terms : KEPT + 2 * terms]
            w = own[KEPT + 2 * terms : KEPT + terms * (2 + PARTS)].reshape(PARTS, terms)
            P = own[KEPT + terms * (2 + PARTS) :].reshape(terms, terms)
            motor = filters[1 + i]
            phi, speed = link[kalman.ANGLE] - motor[kalman.ANGLE], motor[kalman.VELOCITY]
            ring[i, slot] = phi
            swing = window.spread(ring[i]) if full else 0.0
            motion = min(motion, swing)
            fill_basis(kind, phi, scale, f, g, bend)
            if entered == window.RESTARTED:
                kept[AGE], kept[SPEED], kept[PUSH] = 0.0, speed, rows[k, 3 + 2 * i]
                regressors[:] = f
            else:
                stays, earlier, later = _low_pass(par[BANDWIDTH] * elapsed)
                kept[SPEED] = stays * kept[SPEED] + earlier * kept[VELOCITY] + later * speed
                kept[PUSH] = stays * kept[PUSH] + (earlier + later) * rows[k, 3 + 2 * i]
                for j in range(terms):
                    regressors[j] = stays * regressors[j] + earlier * last[j] + later * f[j]
                kept[AGE] += elapsed
            kept[VELOCITY] = speed
            last[:] = f
            moving = full and swing >= par[MINIMUM_MOTION] and par[BANDWIDTH] * kept[AGE] >= SETTLED
            if moving:
                parts[0], parts[1] = par[BANDWIDTH] * (speed - kept[SPEED]), kept[SPEED]
                parts[2] = kept[PUSH] + par[STIFFNESS] * regressors[0]  # the prior law's torque is subtracted
                _fit(par, kept, w, P, regressors, parts, row, gain)
                visit(kept, phi)
            warming = kept[TAKEN] < length
            noise = par[STABILITY] * (1.0 + kept[POWER]) / (1.0 + kept[MEANS])  # with c, P is that of c P(0), over c
            stiffness, slope, uncertain, by_inertia, by_damping = par[STIFFNESS], 0.0, 0.0, 0.0, 0.0
            for j in range(terms):
                share = 0.0 if warming else par[INERTIA] * w[0, j] + par[DAMPING] * w[1, j] - w[2, j]
                stiffness += par[DEVIATION] * share * g[j]
                slope += par[DEVIATION] * share * bend[j]
                by_inertia += w[0, j] * g[j]
                by_damping += w[1, j] * g[j]
                for o in range(terms):
                    uncertain += g[j] * ((1.0 if j == o else 0.0) if warming else noise * P[j, o]) * g[o]
            if not warming:
                uncertain += (par[INERTIA_TOLERANCE] * by_inertia) ** 2 + (par[DAMPING_TOLERANCE] * by_damping) ** 2
            uncertain = par[DEVIATION] ** 2 * max(uncertain, 0.0)
            now[1 + i] = stiffness
            blurred = sqrt(uncertain + slope * slope * (link[kalman.P_XX] + motor[kalman.P_XX]))
            spread[1 + i] = max(blurred, 0.0 if warming or moving else spread[1 + i])
            total += stiffness
            doubt += spread[1 + i] ** 2 + 2.0 * bends * slope * link[kalman.P_XX]  # both share the error of q
            bends += slope
            if warming:
                worst = WARMING_UP
            elif worst != WARMING_UP and not moving:
                worst = NOT_EXCITED
            elif worst == OK and not visited(kept, phi, par[MARGIN]):
                worst = OUTSIDE_RANGE
        now[0], spread[0] = total, sqrt(max(doubt, 0.0))
        state[window.MOTION], state[window.STATUS] = motion, worst
        window.answer(state, worst, out[k])
    return int(out[-1, 1])
