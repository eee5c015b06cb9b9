"""Damping from the dissipation torque where friction, offset and the polynomial's order are unknown.

Source: SAPHARI deliverable, Section 5.1, eqs. (56)-(61), for the model; `damping_models` for the estimator, which
replaces the choice of n, of a friction velocity and of a forgetting factor by hypotheses mixed by their likelihood.

Angle and torque pass the same modulating function psi = w_55 (`damping_equation`). Its shape is nearly a Gaussian of
standard deviation sigma = T / sqrt(52), so that neighbouring rows half a window apart have almost independent noise and
contain all that is in the samples: one equation is taken per half window. The velocities in a window are described by
their mean <zd, psi> and by their variance (sigma <zdd, psi>)^2, with which powers and friction are averaged in closed
form. A window has as many intervals as fit into its span, but at least SHORTEST. Damping is reported at the velocity of
the last sample, to which the window's velocity, acceleration and jerk are extrapolated, and at its time, to which the
trend of the damping is extrapolated.

While the window is not informative, the covariance approaches that of the prior within the rest memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.status import BAD_SAMPLE, NOT_EXCITED, OK, OUTSIDE_RANGE, WARMING_UP

from via_estimators import damping_models, window
from via_estimators.coloured import colours, dot
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.damping_equation import FASTEST, MODULATING_ORDER, REACH, known_of
from via_estimators.damping_models import SHAPES, U
from via_estimators.slots import row_of, slots
from via_estimators.window import HEADER

WIDTH = 1.0 / 52.0  # variance of w_55 on a window of length 1
SHORTEST = 16  # sampling intervals per window
BEND_MEMORY = 1.0  # [s]
ANGLES = 1000.0  # samples over which the noise of the angle is measured
P = slots(
    "length", "span", "velocity_scale", "damping_prior", "damping_deviation", "bend_deviation", "dry_friction",
    "torque_offset", "torque_delay", "torque_noise", "angle_noise", "memory", "rest_memory", "minimum_motion",
    "max_gap", "colour_torque", "colour_velocity", "colour_acceleration",
)  # fmt: skip
# Samples per window, 0 until the sampling rate is known; largest velocity visited; velocity extrapolated to the last
# sample and its variance; samples and time since the last equation or relaxation; variance of the angle's noise;
# mean square of what the jerk adds to the velocity.
LATEST = slots("length", "reached", "velocity", "variance", "samples", "since", "angle", "bend")
STILL, FILLING, MOVING, BAD = range(4)


@dataclass(frozen=True)
class DampingMixtureParameters(Parameters):
    """Parameters of `DampingMixture`."""

    window: int = parameter(100, "largest number of sampling intervals per window", "-", SHORTEST, 1000)
    span: float = parameter(0.05, "length of the window", "s", 1e-3, 10.0)
    velocity_scale: float = parameter(1.0, "velocity at which all powers have equal weight", "rad/s", 1e-3, 1e3)
    damping_prior: float = parameter(0.0, "damping before any data", "N m s/rad", 0.0, 1e6)
    damping_deviation: float = parameter(5.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e6)
    bend_deviation: float = parameter(
        1.0, "standard deviation of the coefficients of higher powers", "N m s/rad", 1e-9, 1e6
    )
    dry_friction: float = parameter(0.3, "standard deviation of dry friction before any data", "N m", 0.0, 1e6)
    torque_offset: float = parameter(0.1, "standard deviation of the torque sensor's offset", "N m", 0.0, 1e6)
    torque_delay: float = parameter(0.005, "standard deviation of the torque's delay", "s", 0.0, 1.0)
    torque_noise: float = parameter(0.05, "expected standard deviation of torque noise", "N m", 1e-9, 1e6)
    angle_noise: float = parameter(3e-5, "least standard deviation of the angle's noise", "rad", 0.0, 1.0)
    memory: float = parameter(10.0, "mean time between changes of the rate at which damping changes", "s", 1e-3, 1e9)
    rest_memory: float = parameter(10.0, "time at rest after which the past has weight 1/e", "s", 1e-3, 1e9)
    minimum_motion: float = parameter(4e-4, "least range of angle in an informative window", "rad", 0.0, 1.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)


@dataclass(frozen=True)
class DampingMixture(Estimator):
    """Damping at the present velocity of a rigid joint with a damper and a sensor for its torque."""

    parameters: DampingMixtureParameters = DampingMixtureParameters()

    @classmethod
    def from_device(cls, device: Device) -> DampingMixture:
        """Parameters of the device file (`damping_equation.known_of`).

        Dry friction and offset may be as large as a tenth of the largest viscous torque at 1 rad/s.
        """
        known, largest = known_of(device), float(device.damping_of(1.0))
        quantum = device.sensors.link_quantum
        known["dry_friction"] = max(device.link.coulomb_friction, 0.1 * largest)
        known["torque_offset"] = 0.05 * largest
        known["bend_deviation"] = known["damping_deviation"] / 3.0
        if quantum is not None:
            known["angle_noise"] = quantum / sqrt(12.0)
        return cls(replace(DampingMixtureParameters(), **known))

    def with_parameters(self, parameters: Parameters) -> DampingMixture:
        return replace(self, parameters=expect(parameters, DampingMixtureParameters))

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("q", "tau_link")

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("damping",)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """Parameter row of the kernel and prior standard deviations (n,) of the unknowns; both writable."""
        own, scales = self.parameters, np.zeros(U.size)
        scales[[U.linear, U.trend]] = own.damping_deviation
        scales[[U.cubic, U.quintic]] = own.bend_deviation
        scales[[U.coulomb, U.stribeck]] = own.dry_friction
        scales[U.between] = 0.3 * own.dry_friction  # a share, +-1 / sqrt(3), of half the expected coefficient
        scales[U.offset] = own.torque_offset
        scales[U.late] = own.torque_delay
        colour = own.window * colours(own.window, MODULATING_ORDER)[:, 0]  # of one interval per window
        given = dict(zip(("colour_torque", "colour_velocity", "colour_acceleration"), colour, strict=True))
        return row_of(P, own, length=own.window + 1, **given), scales

    def init(self) -> Array:
        length = self.parameters.window + 1
        state = np.zeros(_size(length))
        window.start(state)
        state[HEADER.size : HEADER.size + 2] = self.parameters.damping_prior, self.parameters.damping_deviation
        _latest(state)[LATEST.angle] = self.parameters.angle_noise**2
        damping_models.start(_models(state))
        state.flags.writeable = False
        return state

    def covariance(self, state: Array) -> Array:
        """Covariance (n, n) of the unknowns `damping_models.U`, in prior standard deviations."""
        return damping_models.estimate_of(_models(state.copy()))[1].copy()

    def coefficients(self, state: Array) -> Array:
        """Mean (n,) of the unknowns `damping_models.U` [N m s/rad, N m, s]."""
        found = damping_models.estimate_of(_models(state.copy()))[0] * self._constants[1]
        found[U.linear] += self.parameters.damping_prior
        return np.asarray(found)

    def condition(self, state: Array) -> float:
        """Condition number of the root of the covariance."""
        found = np.linalg.eigvalsh(self.covariance(state)[: U.trend, : U.trend])
        return float(np.sqrt(found[-1] / max(found[0], 1e-32 * found[-1], 1e-300)))

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, *self._constants)


@njit(cache=True, error_model="numpy")
def _size(largest: int) -> int:
    """Size of the state: header, value, standard deviation, LATEST, models, then the rings."""
    return HEADER.size + 2 + LATEST.size + damping_models.size() + 4 * largest


@njit(cache=True, error_model="numpy")
def _models(state: Array) -> Array:
    """The view of the bank of filters."""
    at = HEADER.size + 2 + LATEST.size
    return state[at : at + damping_models.size()]


@njit(cache=True, error_model="numpy")
def _latest(state: Array) -> Array:
    """The view (LATEST.size,)."""
    return state[HEADER.size + 2 : HEADER.size + 2 + LATEST.size]


@njit(cache=True, error_model="numpy")
def _rings(state: Array, largest: int, length: int) -> tuple[Array, Array, Array, Array]:
    """The views (L,) of velocities, times, angles and torques; each has room for the `largest` number of samples."""
    at = state.size - 4 * largest
    velocities, times = state[at : at + length], state[at + largest : at + largest + length]
    return velocities, times, state[at + 2 * largest :][:length], state[at + 3 * largest :][:length]


@njit(cache=True, error_model="numpy")
def _advance(par: Array, scales: Array, state: Array, rows: Array, out: Array) -> int:
    slope, shape, work = np.zeros(U.size), np.empty((SHAPES, 2)), damping_models.scratch()
    psi, held = np.empty((3, 0)), np.empty(0)
    for k in range(rows.shape[0]):
        length = max(int(_latest(state)[LATEST.length]), SHORTEST + 1)
        if held.size != length:
            psi, held = np.empty((3, length)), np.empty(length)
        made = _enter(par, scales, state, rows[k], psi, held, slope, shape, work)
        window.answer(state, _report(par, scales, state, made, slope), out[k])
    return int(out[-1, 1])


@njit(cache=True, error_model="numpy")
def _measure(latest: Array, times: Array, angles: Array, slot: int) -> None:
    """Measure the variance of the angle's noise: an angle less the cubic through its four neighbours, on any stamps."""
    middle = (slot - 2) % times.size
    off, share = angles[middle], 1.0
    for i in (0, 1, 3, 4):
        at, weight = (slot - i) % times.size, 1.0
        for j in (0, 1, 3, 4):
            if j != i:
                other = times[(slot - j) % times.size]
                weight *= (times[middle] - other) / (times[at] - other)
        off -= weight * angles[at]
        share += weight * weight
    latest[LATEST.angle] += (off * off / share - latest[LATEST.angle]) / ANGLES


@njit(cache=True, error_model="numpy")
def _enter(
    par: Array, scales: Array, state: Array, row: Array, psi: Array, held: Array, v: Array, shape: Array, work: Array
) -> int:
    """Process a sample row (3,) = time, angle, torque; every half window, give an equation to the models.

    BAD      the sample was skipped
    FILLING  the window is not full yet
    STILL    the window is not informative, or the velocity is not plausible
    MOVING   velocity and its variance are in LATEST
    """
    length, latest = held.size, _latest(state)
    velocities, times, angles, torques = _rings(state, int(par[P.length]), length)
    before, first = state[HEADER.last], state[HEADER.samples] == 0.0
    entered = window.admit(state, times, row, 3, par[P.max_gap])
    if entered == window.SKIPPED:
        return BAD
    slot = int(state[HEADER.slot])
    angles[slot], torques[slot] = row[1], row[2]
    latest[LATEST.since] += 0.0 if first else max(row[0] - before, 0.0)
    latest[LATEST.samples] += 1.0
    if entered == window.RESTARTED:
        velocities[:] = 0.0
    # Only velocities of rows that no longer overlap with this one count as visited.
    earlier = velocities[slot]
    latest[LATEST.reached] = max(latest[LATEST.reached], abs(earlier))
    velocities[slot] = 0.0
    state[HEADER.motion] = 0.0
    full = state[HEADER.filled] >= length
    if full and latest[LATEST.length] == 0.0:
        wanted = par[P.span] / max(times[slot] - times[window.oldest_of(slot, length)], 1e-12) * SHORTEST
        latest[LATEST.length] = min(max(round(wanted) + 1, SHORTEST + 1), int(par[P.length]))
        if latest[LATEST.length] > length:  # the ring is longer from now on
            return FILLING
    if full:
        state[HEADER.motion] = window.span_of(angles)
    span, speed = 0.0, 0.0
    moving = full and state[HEADER.motion] >= par[P.minimum_motion]
    if moving:
        span = window.weigh(MODULATING_ORDER, times, slot, psi, held)
        speed = -dot(psi[1], angles)
        moving = abs(speed) <= FASTEST * par[P.velocity_scale]
    due = latest[LATEST.samples] >= length // 2
    if not moving:
        if due:
            damping_models.relax(_models(state), exp(-latest[LATEST.since] / par[P.rest_memory]))
            latest[LATEST.samples] = latest[LATEST.since] = 0.0
        return STILL if full else FILLING
    velocities[slot] = speed
    acceleration = dot(psi[2], angles)
    _measure(latest, times, angles, slot)
    one = max(latest[LATEST.angle], par[P.angle_noise] ** 2) / (length - 1)
    of_velocity = one * par[P.colour_velocity] / span**2
    _extrapolate(latest, speed, acceleration, earlier, span, span / (length - 1))
    # With c = 1/4, nearly, the velocity is (1 - c) <v> + (1/2 + c) span <a> + c times the earlier one.
    latest[LATEST.variance] += 0.625 * of_velocity + 0.5625 * one * par[P.colour_acceleration] / span**2
    if due:
        latest[LATEST.samples] = latest[LATEST.since] = 0.0
        # Variance of velocities in the window, with that of their mean, which friction sees as well.
        square = WIDTH * (span * acceleration) ** 2 + of_velocity
        damping_models.shapes(speed, square + 1e-18, shape)
        ratio = (speed / par[P.velocity_scale]) ** 2
        share = square / par[P.velocity_scale] ** 2
        v[:] = 0.0
        v[U.linear], v[U.cubic] = speed, speed * (ratio + 3.0 * share)
        v[U.quintic] = speed * (ratio * ratio + 10.0 * ratio * share + 15.0 * share * share)
        v[U.offset] = 1.0
        v[U.late] = damping_models.late(
            _models(state), scales, par[P.damping_prior], speed, acceleration, square + 1e-18
        )
        torque = dot(psi[0], torques) - par[P.damping_prior] * speed
        noise = par[P.torque_noise] ** 2 * par[P.colour_torque] / (length - 1)
        middle = row[0] - 0.5 * span
        damping_models.take(_models(state), middle, par[P.memory], scales, v, shape, torque, noise, work)
    return MOVING


@njit(cache=True, error_model="numpy")
def _extrapolate(latest: Array, speed: float, acceleration: float, earlier: float, span: float, step: float) -> None:
    """Velocity at the last sample, from the window's mean velocity and acceleration, and its error's square.

    The jerk is that between this window and the one before it, `span` + `step` [s] earlier, if its velocity is not 0.
    """
    ahead, since, jerk = 0.5 * span, span + step, 0.0
    if earlier != 0.0:
        jerk = 2.0 * (earlier - speed + acceleration * since) / (since * since)
    bend = jerk * (0.5 * ahead * ahead - 0.5 * WIDTH * span * span)
    latest[LATEST.velocity] = speed + acceleration * ahead + bend
    latest[LATEST.bend] += (bend * bend - latest[LATEST.bend]) * min(step / BEND_MEMORY, 1.0)
    latest[LATEST.variance] = latest[LATEST.bend] / 9.0  # a measure of the following term


@njit(cache=True, error_model="numpy")
def _report(par: Array, scales: Array, state: Array, made: int, slope: Array) -> int:
    """Write value and standard deviation of this step into the state; returns the status; slope (n,) is overwritten."""
    now, latest, models = state[HEADER.size : HEADER.size + 2], _latest(state), _models(state)
    if made == BAD:
        return BAD_SAMPLE
    answer = OK
    if models[damping_models.HEAD.taken] < U.size:
        answer = WARMING_UP
    elif made != MOVING:
        answer = NOT_EXCITED
    elif abs(latest[LATEST.velocity]) > REACH * latest[LATEST.reached]:
        answer = OUTSIDE_RANGE
    state[HEADER.status] = answer
    if answer == WARMING_UP:
        return answer
    mean, covariance = damping_models.estimate_of(models)
    age = state[HEADER.last] - models[damping_models.HEAD.time] if made == MOVING else 0.0
    ratio = (latest[LATEST.velocity] / par[P.velocity_scale]) ** 2
    slope[:] = 0.0
    slope[U.linear], slope[U.trend] = scales[U.linear], scales[U.linear] * age
    slope[U.cubic], slope[U.quintic] = 3.0 * ratio * scales[U.cubic], 5.0 * ratio * ratio * scales[U.quintic]
    value, variance = par[P.damping_prior], damping_models.wander(models, age) * scales[U.linear] ** 2
    for i in range(U.size):
        value += slope[i] * mean[i]
        for k in range(U.size):
            variance += slope[i] * covariance[i, k] * slope[k]
    bend = (6.0 * mean[U.cubic] * scales[U.cubic] + 20.0 * ratio * mean[U.quintic] * scales[U.quintic]) * sqrt(ratio)
    variance += (bend / par[P.velocity_scale]) ** 2 * latest[LATEST.variance]
    sd = sqrt(max(variance, 0.0))
    if made == MOVING:
        now[0], now[1] = value, sd
    else:  # the last value is kept
        now[1] = max(now[1], min(sd, par[P.damping_deviation]))
    return answer
