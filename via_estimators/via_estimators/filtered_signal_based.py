"""Stiffness from noisy signals without a model or a velocity sensor: smoothed parameters, current deflection.

Source: SAPHARI deliverable, Sections 4.3, 4.4 and eq. (55). The equation is that of `signal_based`, with all signals
smoothed by the same Savitzky-Golay filter over W = window + 1 samples (`savitzky_golay`; W is odd, unlike the printed
1000). The equation is linear in torque, angle and f_j(phi), so a linear filter leaves it valid if the f_j are smoothed
and not phi. The velocity of the motor is the filter's slope of theta. Parameters are thus delayed by (W - 1)/2 samples,
which is acceptable since they are nearly constant. The deflection is not delayed: kinematic Kalman filters of q and
theta estimate it at the newest sample, plain or modified for quantised encoders (`kinematic_kalman`).

The filter requires equidistant samples: a step that differs by more than half a sampling interval counts as a gap and
restarts the window, so each lost sample costs a whole window; do not use this method on lossy connections. The mean
step of the window scales slope and integrals.

Standard deviations. The smoothing separates the noise of torques and angles from the signals, so its variances are
measured directly. Smoothed noise is not white; the equation accounts for its autocorrelation (`colour`), without which
the standard deviation would be 9 % too large for integrals no longer than the noise's correlation (W / order samples).
Noise of the angles acts as torque through the stiffness, and through g at the present deflection with the variance of
the Kalman filters. The truncation of the basis is included as in `signal_based`. Not included: the difference between
the slope of theta and that of the smoothed theta (motion faster than about order / (2 W) per sample), dry friction,
drift of the spring law, and the bias towards 0 due to errors in the regressors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import cos, exp, sin

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import integral, integrated_equation, transmissions, window
from via_estimators import kinematic_kalman as kalman
from via_estimators.basis import BASES, MOST_TERMS, fill_basis
from via_estimators.coloured import dot
from via_estimators.contract import Estimator, Kernel, Parameters, choice, expect, parameter
from via_estimators.integrated_equation import FURTHEST, KEPT, N_ESTIMATE, E, P
from via_estimators.savitzky_golay import savitzky_golay
from via_estimators.signal_based import SignalBased
from via_estimators.slots import slots
from via_estimators.transmissions import JOINT
from via_estimators.window import HEADER

# Of a transmission, before its equation: sum of weights, of squares of torque noise, of angle noise.
NOISE = slots("weight", "torque", "angle")
MOTOR = slots("angle", "velocity", "torque")  # smoothed
THETA, TAU, BASIS = range(3)  # columns of a transmission in the ring: theta, tau, f_1 = phi, f_2, ..
EARLIEST, LATEST = 0.5, 1.5  # [sampling intervals] steps outside are gaps
BACK = 50.0  # [sampling intervals] a stamp earlier than that means that the clock was reset
POLES = 2  # of `colour`
PROBES = 100  # samples of a window whose range is the motion


@dataclass(frozen=True)
class FilteredSignalBasedParameters(Parameters):
    """Parameters of `FilteredSignalBased`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(1000, "sampling intervals per smoothing window, even", "-", 20, 4000)
    order: int = parameter(20, "degree of the smoothing polynomial", "-", 1, 60)
    basis: str = choice("odd_powers", "basis functions of the spring law", tuple(BASES))
    terms: int = parameter(4, "number of basis functions", "-", 1, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over that expected; 0: the basis is exact", "-", 0.0, 10.0)
    memory: float = parameter(1e9, "time after which a row has weight 1/e", "s", 1e-3, 1e9)
    horizon: float = parameter(0.05, "longest integral before a new one begins", "s", 1e-3, 1e9)
    sampling: float = parameter(1e-3, "expected sampling interval", "s", 1e-5, 1.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.0, "motor inertia before any data", "kg m^2", 0.0, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-12, 1e9)
    acceleration: float = parameter(20.0, "sqrt(V_a) of the Kalman filters of angles", "rad/s^2", 1e-3, 1e9)
    quantum: float = parameter(0.0, "step of the encoders; 0: plain Kalman filter", "rad", 0.0, 0.1)
    position_noise: float = parameter(3e-5, "standard deviation of angle noise before quantisation", "rad", 1e-9, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative window", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)

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
        """Scales and priors of the order of magnitude that the device file states."""
        like = SignalBased.from_device(device).parameters
        shared = (
            "transmissions", "basis", "terms", "sampling", "deflection_scale", "stiffness_prior", "stiffness_deviation",
            "inertia_prior", "inertia_deviation", "damping_prior", "damping_deviation", "torque_noise",
            "minimum_motion", "range_margin",
        )  # fmt: skip
        return cls(
            FilteredSignalBasedParameters(
                **{name: getattr(like, name) for name in shared}, **transmissions.encoders_of(device)
            )
        )

    def with_parameters(self, parameters: Parameters) -> FilteredSignalBased:
        return replace(self, parameters=expect(parameters, FilteredSignalBasedParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @cached_property
    def _constants(self) -> tuple[Array, Array, Array, Array]:
        """Parameter rows of equation and Kalman filters, weights (2, W), colour; writable to avoid a recompile."""
        own = self.parameters
        row = integrated_equation.parameter_row(own, max_gap=BACK * own.sampling, velocity_noise=0.0)
        weights = np.stack(savitzky_golay(own.window + 1, own.order))
        return row, kalman.parameter_row(own), weights, colour(float(weights[0, own.window // 2]))

    def init(self) -> Array:
        own = self.parameters
        functions = own.terms + integrated_equation.omitted(BASES[own.basis])
        rings = (own.window + 1) * (1 + own.transmissions * (BASIS + functions))
        filters = (1 + own.transmissions) * kalman.F.size
        return integrated_equation.initial_state(own, rings + filters, NOISE.size, POLES)

    def condition(self, state: Array) -> float:
        return integrated_equation.condition(self.parameters, state, NOISE.size, POLES)

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


def colour(share: float) -> Array:
    """Colour (3, 3), as `integral.rebase` takes it, of white noise of variance 1 after a low pass of DC gain 1.

    share  r_0, the variance after the filter

    A second-order Butterworth filter approximates it: r_d = r_0 exp(-a d) (cos a d + sin a d); with a = 2 r_0 the sum
    of r_d equals the DC gain. The variance of integrated noise differs by 1 % from that of the true r_d.
    """
    a = 2.0 * share
    c, s = exp(-a) * cos(a), exp(-a) * sin(a)
    return np.array([[share, 1.0, 1.0], [share * c, c, -s], [share * s, s, c]])


@njit(cache=True, error_model="numpy")
def _smooth(weights: Array, ring: Array, oldest: int) -> float:
    """Inner product of weights (L,), oldest first, with a ring (L,) whose oldest value is at position `oldest`."""
    later = ring.size - oldest
    return dot(weights[:later], ring[oldest:]) + dot(weights[later:], ring[:oldest])


@njit(cache=True, error_model="numpy")
def _swing(phi: Array) -> float:
    """Range of the deflection over its ring (L,), from about PROBES samples."""
    low = high = phi[0]
    for k in range(0, phi.size, max(phi.size // PROBES, 1)):
        low, high = min(low, phi[k]), max(high, phi[k])
    return high - low


@njit(cache=True, error_model="numpy", forceinline=True)
def _enter(par: Array, state: Array, times: Array, sample: Array, elapsed_before: float) -> int:
    """`transmissions.enter`; in addition a step that is too short or too long restarts the window."""
    interval = par[P.sampling]
    entered = transmissions.enter(state, times, sample, 2, FURTHEST * par[P.deflection_scale], BACK * interval)
    if entered == window.TAKEN and not EARLIEST * interval <= elapsed_before <= LATEST * interval:
        entered = window.RESTARTED
        state[HEADER.filled] = 1.0
        state[HEADER.gaps] += 1.0
    return entered


@njit(cache=True, error_model="numpy", forceinline=True)
def _store(par: Array, sample: Array, slot: int, ring: Array, basis: Array) -> None:
    """Write theta, tau and f_j(phi) of each transmission into ring (m, channels, L)."""
    for i in range(ring.shape[0]):
        theta = sample[2 + 2 * i]
        ring[i, THETA, slot], ring[i, TAU, slot] = theta, sample[3 + 2 * i]
        fill_basis(int(par[P.basis]), sample[1] - theta, par[P.deflection_scale], basis[0], basis[1], basis[2])
        ring[i, BASIS:, slot] = basis[0]


@njit(cache=True, error_model="numpy", forceinline=True)
def _smooth_all(weights: Array, own: Array, oldest: int, step: float, motor: Array, f: Array, noise: Array) -> None:
    """Smoothed motor signals (MOTOR.size,) and basis f (functions,); adds what the smoothing removed to `noise`.

    own  (channels, L) ring of a transmission
    """
    half, length = own.shape[1] // 2, own.shape[1]
    middle = oldest + half if oldest + half < length else oldest + half - length
    motor[MOTOR.angle] = _smooth(weights[0], own[THETA], oldest)
    motor[MOTOR.velocity] = _smooth(weights[1], own[THETA], oldest) / step
    motor[MOTOR.torque] = _smooth(weights[0], own[TAU], oldest)
    noise[NOISE.weight] += 1.0 - weights[0, half]  # share of the variance of white noise that smoothing removes
    for j in range(f.size):
        f[j] = _smooth(weights[0], own[BASIS + j], oldest)
    noise[NOISE.torque] += (own[TAU, middle] - motor[MOTOR.torque]) ** 2
    noise[NOISE.angle] += (own[BASIS, middle] - f[0]) ** 2


@njit(cache=True, error_model="numpy")
def _advance(par: Array, kinematic: Array, weights: Array, shade: Array, state: Array, rows: Array, out: Array) -> int:
    length, m, terms = int(par[P.length]), int(par[P.transmissions]), int(par[P.terms])
    functions = terms + integrated_equation.omitted(int(par[P.basis]))
    value, sd = window.outputs(state, 1 + 3 * m)
    at, columns = HEADER.size + 2 * value.size, m * (BASIS + functions)
    times, flat = window.rings(state, at, length, columns)
    ring = flat.reshape(m, BASIS + functions, length)
    at += length * (1 + columns)
    filters = state[at : at + (1 + m) * kalman.F.size].reshape(1 + m, kalman.F.size)
    parts = state[at + (1 + m) * kalman.F.size :].reshape(m, -1)
    own = KEPT.size + functions
    joint, found, motor = np.empty(JOINT.size), np.empty(N_ESTIMATE), np.zeros(MOTOR.size)
    basis, work = np.empty((3, functions)), integrated_equation.scratch(3 + functions)
    for k in range(rows.shape[0]):
        elapsed = max(rows[k, 0] - state[HEADER.last], 0.0) if state[HEADER.samples] > 0.0 else 0.0
        entered = _enter(par, state, times, rows[k], elapsed)
        if entered == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        slot, full = int(state[HEADER.slot]), state[HEADER.filled] == length
        oldest = window.oldest_of(slot, length)
        step = (times[slot] - times[oldest]) / (length - 1.0) if full else par[P.sampling]
        keep = exp(-elapsed / par[P.memory])  # also for the time in a gap or before the window is full
        _store(par, rows[k], slot, ring, basis)
        kalman.follow(kinematic, filters, rows[k], elapsed, entered == window.RESTARTED)
        link = filters[0]
        transmissions.begin(joint)
        for i in range(m):
            part, turning = parts[i], filters[1 + i]
            noise, equation = part[own : own + NOISE.size], part[own + NOISE.size :]
            swing = _swing(ring[i, BASIS]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], swing)
            moving = full and swing >= par[P.minimum_motion]
            noise *= keep
            if moving:
                _smooth_all(weights, ring[i], oldest, step, motor, basis[0], noise)
                transmissions.visit(part, basis[0, 0])
            integrated_equation.learn(
                par, shade, part, equation, step, keep, moving, motor[0], motor[1], motor[2], basis[0], work
            )
            warming = equation[integral.HEAD.taken] < length
            phi, declared = link[kalman.F.angle] - turning[kalman.F.angle], par[P.torque_noise] ** 2
            through = value[1 + i] ** 2 * noise[NOISE.angle]
            white = (declared + noise[NOISE.torque] + through) / (1.0 + noise[NOISE.weight])
            integrated_equation.evaluate(par, part, equation, warming, phi, white / declared, 0.0, found, work)
            blur = found[E.slope] * found[E.slope] * (link[kalman.F.p_xx] + turning[kalman.F.p_xx])
            integrated_equation.report(found, i, blur, link[kalman.F.p_xx], warming or moving, value, sd, joint)
            transmissions.grade(joint, warming, moving, transmissions.inside(part, phi, par[P.range_margin]))
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
