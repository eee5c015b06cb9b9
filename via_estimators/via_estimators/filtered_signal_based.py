"""Stiffness from noisy signals, no model and no velocity sensor: smoothed, late parameters at the present deflection.

Source: SAPHARI deliverable, Sections 4.3, 4.4 and eq. (55). The equation is that of `signal_based`, with all of its
signals smoothed by the same Savitzky-Golay filter over W = window + 1 samples (`savitzky_golay`; W is odd, which 1000
is not). Being linear, the filter leaves the equation true, which is linear in torque, angle and f_j(phi): so smoothed
are the f_j, not phi, of which f_j is no linear function. The motor's velocity is the filter's slope of theta.
Parameters are thus (W - 1)/2 samples late, which they bear, being constant or nearly so. The deflection is not late:
kinematic Kalman filters of q and theta give it at the newest sample, plain or modified for quantised encoders
(`kinematic_kalman`).

The filter asks for equidistant samples: a step that is more than half a sampling interval too short or too long counts
as a gap and restarts the window, so that one sample lost costs a whole window: not for lossy lines. The actual mean
step of the window scales slope and integrals.

Standard deviations. What the smoothing takes away from torques and angles is their noise, so its variances are measured
directly and need no model. Smoothed noise is not white, and its colour is told to the equation (`colour`): taken for
white it would count too much, by 9 % of the deviation with integrals no longer than the noise's correlation (W / order
samples), as what they make of noise from one reset to the next is a comb of which only the slow part gets through.
Noise of the angles acts as torque through the stiffness, and through g at the present deflection with the Kalman
filters' own variance. What the basis cuts off is told as in `signal_based`. Left out: a slope of theta
that is not quite the slope of the smoothed theta (motion faster than about order / (2 W) per sample), dry friction,
drift of the law, and the pull towards 0 that errors in regressors exert.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import cos, exp, sin, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import Status

from via_estimators import integral, window
from via_estimators import kinematic_kalman as kalman
from via_estimators.basis import BASES, MOST_TERMS, fill_basis
from via_estimators.coloured import dot
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter
from via_estimators.savitzky_golay import savitzky_golay
from via_estimators.signal_based import (
    BEYOND,
    KIND,
    LENGTH,
    MARGIN,
    MEMORY,
    MINIMUM_MOTION,
    N_KEPT,
    PRIOR,
    SAMPLING,
    SCALE,
    TERMS,
    TORQUE_NOISE,
    TRANSMISSIONS,
    SignalBased,
    cut_off,
    learn,
    scratch,
    tell,
    visit,
    visited,
)

# of a transmission, beside what `signal_based` keeps: sum of weights, of squares of torque noise, of angle noise
WEIGHT, ROUGH_TORQUE, ROUGH_ANGLE, N_ROUGH = range(4)
ACCELERATION, QUANTUM, WHITE, N_KALMAN = range(4)
EARLIEST, LATEST = 0.5, 1.5  # a step of so many sampling intervals is no gap
BACK = 50.0  # sampling intervals: a stamp further back is a clock set anew
FASTEST = 10.0  # [rad/s] standard deviation of a velocity not known yet
POLES = 2  # of `colour`
PROBES = 100  # samples of a window at which motion is judged
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class FilteredSignalBasedParameters(Parameters):
    """Parameters of `FilteredSignalBased`; the deviations are those of the prior, wide enough to be forgotten."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(1000, "sampling intervals per smoothing window, even", "-", 20, 4000)
    order: int = parameter(20, "degree of the polynomial that smoothes", "-", 1, 60)
    basis: str = choice("odd_powers", "functions that make up the torque law", tuple(BASES))
    terms: int = parameter(4, "number of them", "-", 1, MOST_TERMS)
    truncation: float = parameter(1.0, "doubt about the law cut off, over what is expected; 0: none is", "-", 0.0, 10.0)
    memory: float = parameter(1e9, "time after which a row counts 1/e", "s", 1e-3, 1e9)
    horizon: float = parameter(0.05, "longest integral before a new one begins", "s", 1e-3, 1e9)
    sampling: float = parameter(1e-3, "sampling interval expected", "s", 1e-5, 1.0)
    deflection_scale: float = parameter(1.0, "deflection at which the terms of the law count alike", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of that", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of that", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of that", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "standard deviation of torque noise expected", "N m", 1e-12, 1e9)
    acceleration: float = parameter(20.0, "sqrt(V_a) of the Kalman filters of angles", "rad/s^2", 1e-3, 1e9)
    quantum: float = parameter(0.0, "step of the encoders; 0: plain Kalman filter", "rad", 0.0, 0.1)
    position_noise: float = parameter(3e-5, "white noise of one angle sample before that", "rad", 1e-9, 0.1)
    minimum_motion: float = parameter(0.01, "range of deflection below which a window tells nothing", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "share of the visited range that counts as visited beyond it", "-", 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window % 2:
            raise ParameterError(f"window must be even, an odd number of samples with one at its centre: {self.window}")
        if self.order > self.window:
            raise ParameterError(f"order must be at most the window of {self.window} intervals, got {self.order}")


@dataclass(frozen=True)
class FilteredSignalBased(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides, smoothed."""

    parameters: FilteredSignalBasedParameters = FilteredSignalBasedParameters()

    @classmethod
    def from_device(cls, device: Device) -> FilteredSignalBased:
        """Scales and priors from a device file: its numbers say the order of magnitude, not the answer."""
        like = SignalBased.from_device(device).parameters
        shared = (
            "transmissions", "basis", "terms", "sampling", "deflection_scale", "stiffness_prior", "stiffness_deviation",
            "inertia_prior", "inertia_deviation", "damping_prior", "damping_deviation", "torque_noise",
            "minimum_motion", "range_margin",
        )  # fmt: skip
        quantum = max(device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0)
        return cls(
            FilteredSignalBasedParameters(
                **{name: getattr(like, name) for name in shared},
                quantum=quantum,
                position_noise=max(0.1 * quantum, 1e-9),
            )
        )

    def having(self, parameters: Parameters) -> FilteredSignalBased:
        return replace(self, parameters=expect(parameters, FilteredSignalBasedParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        each = range(1, self.parameters.transmissions + 1)
        return ("q", *(name for i in each for name in (f"theta_{i}", f"tau_{i}")))

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        each = range(1, self.parameters.transmissions + 1)
        return (
            "stiffness",
            *(f"stiffness_{i}" for i in each),
            *(f"motor_inertia_{i}" for i in each),
            *(f"motor_damping_{i}" for i in each),
        )

    @cached_property
    def _constants(self) -> tuple[Array, Array, Array, Array]:
        """Parameter rows of equation and Kalman filters, filter weights (2, W); not locked, another type to compile."""
        own = self.parameters
        n = own.terms + 3
        row = np.zeros(PRIOR + 2 * n)
        row[:PRIOR] = (
            own.window + 1, own.transmissions, BASES[own.basis], own.terms, own.memory, BACK * own.sampling,
            own.sampling, own.torque_noise, 0.0, own.position_noise, own.deflection_scale, own.minimum_motion,
            own.range_margin, own.horizon, own.truncation,
        )  # fmt: skip
        row[PRIOR + 1 : PRIOR + 4] = own.inertia_prior, own.damping_prior, own.stiffness_prior
        row[PRIOR + n + 1 : PRIOR + n + 3] = own.inertia_deviation, own.damping_deviation
        row[PRIOR + n + 3 :] = own.stiffness_deviation
        kinematic = np.array([own.acceleration**2, own.quantum, own.position_noise**2])
        weights = np.stack(savitzky_golay(own.window + 1, own.order))
        return row, kinematic, weights, colour(float(weights[0, own.window // 2]))

    def init(self) -> Array:
        own = self.parameters
        m, n, length, cut = own.transmissions, own.terms + 3, own.window + 1, cut_off(BASES[own.basis])
        each = N_KEPT + own.terms + cut + N_ROUGH + integral.size(n, cut, POLES)
        rings = length * (1 + m * (2 + own.terms + cut))
        state = np.zeros(window.HEADER + 2 * len(self.outputs) + rings + (1 + m) * kalman.SIZE + m * each)
        window.start(state)
        held = (
            m * own.stiffness_prior, *(m * (own.stiffness_prior,)), *(m * (own.inertia_prior,)),
            *(m * (own.damping_prior,)), sqrt(m) * own.stiffness_deviation, *(m * (own.stiffness_deviation,)),
            *(m * (own.inertia_deviation,)), *(m * (own.damping_deviation,)),
        )  # fmt: skip
        state[window.HEADER : window.HEADER + len(held)] = held
        for i in range(m):
            integral.start(self._equation(state, i), n, cut, POLES)
        state.flags.writeable = False
        return state

    def condition(self, state: Array) -> float:
        n = self.parameters.terms + 3
        factors = [integral.factor(self._equation(state, i), n) for i in range(self.parameters.transmissions)]
        return max(float(np.linalg.cond(R[1:n, 1:n])) for R in factors)

    def _equation(self, state: Array, i: int) -> Array:
        """The view into transmission i's equation, i from 0."""
        own = self.parameters
        cut = cut_off(BASES[own.basis])
        size = integral.size(own.terms + 3, cut, POLES)
        end = len(state) - (own.transmissions - 1 - i) * (N_KEPT + own.terms + cut + N_ROUGH + size)
        return state[end - size : end]

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


def colour(share: float) -> Array:
    """Colour (3, 3), as `integral.rebase` has it, of white noise of variance 1 after a low pass of gain 1 at rest.

    share  r_0, the variance that it leaves

    A Butterworth filter of second order stands for the smoothing: r_d = r_0 exp(-a d) (cos a d + sin a d), and with
    a = 2 r_0 they add up to the gain at rest. What the integrals make of noise differs by 1 % from the true r_d's.
    """
    a = 2.0 * share
    c, s = exp(-a) * cos(a), exp(-a) * sin(a)
    return np.array([[share, 1.0, 1.0], [share * c, c, -s], [share * s, s, c]])


@njit(cache=True, error_model="numpy")
def _smooth(weights: Array, ring: Array, oldest: int) -> float:
    """Inner product of weights (L,), oldest first, with a ring (L,) whose oldest value is in slot `oldest`."""
    later = ring.size - oldest
    return dot(weights[:later], ring[oldest:]) + dot(weights[later:], ring[:oldest])


@njit(cache=True, error_model="numpy")
def _swing(phi: Array) -> float:
    """Range of the deflection over its ring (L,), seen at every so many-th sample."""
    low = high = phi[0]
    for k in range(0, phi.size, max(phi.size // PROBES, 1)):
        low, high = min(low, phi[k]), max(high, phi[k])
    return high - low


@njit(cache=True, error_model="numpy")
def _advance(par: Array, kinematic: Array, weights: Array, shade: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, terms = int(par[LENGTH]), int(par[TRANSMISSIONS]), int(par[TERMS])
    kind, n, outputs, half = int(par[KIND]), terms + 3, 1 + 3 * m, length // 2
    functions = terms + cut_off(kind)
    interval, scale = par[SAMPLING], par[SCALE]
    at = window.HEADER
    now, spread = state[at : at + outputs], state[at + outputs : at + 2 * outputs]
    at += 2 * outputs
    times = state[at : at + length]
    at += length
    channels = 2 + functions  # of a transmission: theta, tau, f_j(phi), of which the first is phi in every basis
    ring = state[at : at + length * channels * m].reshape(channels * m, length)
    at += length * channels * m
    filters = state[at : at + (1 + m) * kalman.SIZE].reshape(1 + m, kalman.SIZE)
    at += (1 + m) * kalman.SIZE
    own = N_KEPT + functions
    each = own + N_ROUGH + integral.size(n, functions - terms, POLES)
    told, late, basis, work = np.empty(7), np.empty(3), np.empty((3, functions)), scratch(3 + functions)
    fitted = 1.0 - weights[0, half]  # share of the variance of white noise that smoothing takes away
    for k in range(rows.shape[0]):
        before = state[window.LAST]
        absurd = False
        for i in range(m):
            absurd = absurd or abs(rows[k, 1] - rows[k, 2 + 2 * i]) > BEYOND * scale
        entered = window.refuse(state) if absurd else window.admit(state, times, rows[k], 2 + 2 * m, BACK * interval)
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        elapsed = max(rows[k, 0] - before, 0.0) if state[window.SAMPLES] > 1.0 else 0.0
        if entered == window.TAKEN and not EARLIEST * interval <= elapsed <= LATEST * interval:
            entered = window.RESTARTED
            state[window.FILLED] = 1.0
            state[window.GAPS] += 1.0
        slot, q = int(state[window.SLOT]), rows[k, 1]
        full = state[window.FILLED] == length
        oldest = slot + 1 if slot + 1 < length else 0
        middle = oldest + half if oldest + half < length else oldest + half - length
        step = (times[slot] - times[oldest]) / (length - 1.0) if full else interval
        keep = exp(-elapsed / par[MEMORY])  # time in a gap, or until a window is full, counts like any other
        for i in range(m):
            c = channels * i
            ring[c, slot], ring[c + 1, slot] = rows[k, 2 + 2 * i], rows[k, 3 + 2 * i]
            fill_basis(kind, q - rows[k, 2 + 2 * i], scale, basis[0], basis[1], basis[2])
            ring[c + 2 : c + channels, slot] = basis[0]
        for i in range(1 + m):
            reading = q if i == 0 else rows[k, 2 * i]
            if entered == window.RESTARTED:
                kalman.start(filters[i], reading, kinematic[WHITE] + kinematic[QUANTUM] ** 2 / 12.0, FASTEST)
                continue
            kalman.predict(filters[i], elapsed, kinematic[ACCELERATION])
            if kinematic[QUANTUM] > 0.0:
                kalman.correct_quantised(filters[i], reading, kinematic[QUANTUM], kinematic[WHITE])
            else:
                kalman.correct(filters[i], reading, kinematic[WHITE])
        link = filters[0]
        worst, motion, total, doubt, bends = OK, np.inf, 0.0, 0.0, 0.0
        for i in range(m):
            kept = state[at + i * each : at + i * each + own]
            rough = state[at + i * each + own : at + i * each + own + N_ROUGH]
            equation = state[at + i * each + own + N_ROUGH : at + (i + 1) * each]
            c = channels * i
            angles, efforts, deflections = ring[c], ring[c + 1], ring[c + 2]
            swing = _swing(deflections) if full else 0.0
            motion = min(motion, swing)
            moving = full and swing >= par[MINIMUM_MOTION]
            rough *= keep
            if moving:
                late[0] = _smooth(weights[0], angles, oldest)
                late[1] = _smooth(weights[1], angles, oldest) / step
                late[2] = _smooth(weights[0], efforts, oldest)
                rough[WEIGHT] += fitted
                for j in range(functions):
                    basis[0, j] = _smooth(weights[0], ring[c + 2 + j], oldest)
                rough[ROUGH_TORQUE] += (efforts[middle] - late[2]) ** 2
                rough[ROUGH_ANGLE] += (deflections[middle] - basis[0, 0]) ** 2
                visit(kept, basis[0, 0])
            learn(par, shade, kept, equation, step, keep, moving, late[0], late[1], late[2], basis[0], work)
            warming = equation[integral.TAKEN] < length
            motor = filters[1 + i]
            phi = link[kalman.ANGLE] - motor[kalman.ANGLE]
            declared = par[TORQUE_NOISE] ** 2
            white = (declared + rough[ROUGH_TORQUE] + now[1 + i] ** 2 * rough[ROUGH_ANGLE]) / (1.0 + rough[WEIGHT])
            tell(par, kept, equation, warming, phi, white / declared, 0.0, told, work)
            # Forgetting without motion trades data for the leak, which knows no more than they did: never narrower.
            floor = 0.0 if warming or moving else 1.0
            at_i, at_B, at_D = 1 + i, 1 + m + i, 1 + 2 * m + i
            now[at_i], now[at_B], now[at_D] = told[0], told[2], told[3]
            blur = told[1] * told[1] * (link[kalman.P_XX] + motor[kalman.P_XX])
            spread[at_i] = max(sqrt(told[4] + blur), floor * spread[at_i])
            spread[at_B] = max(sqrt(told[5]), floor * spread[at_B])
            spread[at_D] = max(sqrt(told[6]), floor * spread[at_D])
            total += told[0]
            doubt += spread[at_i] ** 2 + 2.0 * bends * told[1] * link[kalman.P_XX]  # both share the error of q
            bends += told[1]
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
