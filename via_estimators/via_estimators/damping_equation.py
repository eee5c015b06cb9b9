"""The damping of a joint from its dissipation torque: the rows, the statuses and the deviations, whoever solves them.

Source: SAPHARI deliverable, Section 5.1, eqs. (56)-(61): the dissipation torque is odd in the deflection velocity,

    tau_d = v' w,   v_j = s (zd/s)^(2j-1),   D = dtau_d/dzd = sum_j (2j-1) (zd/s)^(2j-2) w_j,

with the document's powers for s = 1 rad/s; another s gives every w_j the unit N m s/rad and lets P and its growth count
for less in a bend of the law than in the damping itself. Beside the powers stands one unknown more,

    w_F F zd / sqrt(zd^2 + v_F^2)

dry friction as a multiple of what the device may have (F; with F = 0 only the document's powers remain). It is odd too,
but no damping and left out of D. Powers alone take friction for damping: F sign(zd) reads as about F / |zd| more, so
that the estimate swings twice per period of the motion, up where it reverses (document: errors of 5 to 30 %).

No velocity is measured, and a difference of encoder samples would be noise (.1 rad/s at 16 bit and 1 kHz). Angle and
torque therefore pass the same short modulating function psi = w_55,

    zd = <zd, psi> = -<z, psi'>,   tau_d = <tau_d, psi>,

by the weights of via_core.weak_form on the actual stamps. The two share one phase, so that a delay between them cannot
turn damping into something else: exact for the linear term, and up to (T zdd)^2 / 17 beside zd^2 for the cubic one. All
is half a window late. On a rigid joint whose motor is held the deflection z is the link angle q.

Deviations come from `recursive_error`: noise, as large as the last thousand innovations show (from rows where it is no
longer the prior that they show); what is left of the prior; and the lag behind a damping that changes as the estimate
did over the last .3 s. Left out: what friction is beyond its unknown (a Stribeck peak), and all of it where F = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import Any

from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import Status

from via_estimators import recursive_error, window
from via_estimators.coloured import colours, dot
from via_estimators.contract import Parameters, parameter

MODULATING_ORDER = 5
MOST_TERMS = 3
FASTEST = 1e3  # velocities beyond so many scales are no velocities
REACH = 1.02  # velocities up to so many times the largest one visited count as visited
RATE_MEMORY = 0.3  # [s] over which the change of the damping is looked at
MEMORY = 0.999  # of innovations, per row
KNOWN = 1.0  # the declared noise counts as much as one independent innovation
(LENGTH, TERMS, MAX_GAP, SCALE, MINIMUM_MOTION, NOISE, PRIOR, PRIOR_DEVIATION, BEND_DEVIATION) = range(9)
FRICTION, FRICTION_VELOCITY, REST_MEMORY, LIMIT, N_OWN = range(9, 14)
MISFIT, EXPECTED, TAKEN, REACHED, SPEED, TORQUE, SPAN, STEP, SLOW, N_COUNTERS = range(10)
MOVING, STILL, FILLING, BAD = range(4)
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE = (int(status) for status in Status)


@dataclass(frozen=True)
class DampingParameters(Parameters):
    """What every solver of this equation is told."""

    window: int = parameter(40, "sampling intervals per window", "-", 10, 500)
    terms: int = parameter(1, "odd powers of the velocity, n", "-", 1, MOST_TERMS)
    velocity_scale: float = parameter(4.0, "velocity at which all powers count alike", "rad/s", 1e-3, 1e3)
    damping_prior: float = parameter(0.0, "damping before any data, w(0)", "N m s/rad", 0.0, 1e6)
    damping_deviation: float = parameter(5.0, "standard deviation of that", "N m s/rad", 1e-9, 1e6)
    bend_deviation: float = parameter(0.5, "standard deviation of higher powers' shares", "N m s/rad", 1e-9, 1e6)
    rest_memory: float = parameter(10.0, "time at rest after which the past counts 1/e", "s", 1e-3, 1e9)
    dry_friction: float = parameter(0.05, "standard deviation of dry friction before any data", "N m", 0.0, 1e6)
    friction_velocity: float = parameter(0.05, "velocity at which 71 % of dry friction acts", "rad/s", 1e-6, 1e3)
    torque_noise: float = parameter(0.05, "standard deviation of torque noise expected", "N m", 1e-9, 1e6)
    minimum_motion: float = parameter(4e-4, "range of angle in a window below which it tells nothing", "rad", 0.0, 1.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    initial_covariance: float = parameter(10.0, "covariance before any data, P(0)", "1/(rad/s)^2", 1e-9, 1e9)
    covariance_limit: float = parameter(
        10.0, "mean variance in P at which it is full, p_max", "1/(rad/s)^2", 1e-9, 1e12
    )

    def row(self) -> tuple[float, ...]:
        """The first N_OWN numbers of a kernel's parameter row."""
        return (
            self.window + 1, self.terms, self.max_gap, self.velocity_scale, self.minimum_motion, self.torque_noise,
            self.damping_prior, self.damping_deviation, self.bend_deviation, self.dry_friction,
            self.friction_velocity, self.rest_memory, self.covariance_limit,
        )  # fmt: skip

    def colour(self) -> Array:
        """Autocorrelation (L,) of the window's weights on torque."""
        return colours(self.window, MODULATING_ORDER)[0].copy()


def known_of(device: Device) -> dict[str, Any]:
    """Parameters that a device file tells: the damper's range as prior, dry friction, the sensors' noise and quantum.

    Raises ParameterError unless the device is a rigid joint with a damper and a sensor for its torque. (Through a
    spring the sensor would read the spring's torque too.)
    """
    sensors = device.sensors
    if device.damper is None or device.arrangement != "rigid" or sensors.link_torque_noise is None:
        raise ParameterError(f"'{device.name}' is no rigid joint with a damper and a sensor for its torque")
    low, high = (float(device.damping_of(u)) for u in (0.0, 1.0))
    known = {
        "damping_prior": 0.5 * (low + high),
        "damping_deviation": max(high - low, 0.5 * high),
        "dry_friction": device.link.coulomb_friction or sensors.link_torque_noise,  # less would not be seen
        "torque_noise": max(sensors.link_torque_noise, 1e-9),
    }
    if sensors.link_quantum is not None:
        known["minimum_motion"] = 4.0 * sensors.link_quantum
    return known


@njit(cache=True, error_model="numpy")
def size(n: int, length: int) -> int:
    """Floats in the state: header, value, deviation, counters, w, lag, C, Q, gains, velocities, times, samples."""
    return window.HEADER + 2 + N_COUNTERS + 2 * n + 2 * n * n + n * length + 4 * length


@njit(cache=True, error_model="numpy")
def counters(state: Array) -> Array:
    """The view (N_COUNTERS,) of sums and latest numbers."""
    return state[window.HEADER + 2 : window.HEADER + 2 + N_COUNTERS]


@njit(cache=True, error_model="numpy")
def coefficients(state: Array, n: int) -> Array:
    """The view w (n,) [N m s/rad]."""
    at = window.HEADER + 2 + N_COUNTERS
    return state[at : at + n]


@njit(cache=True, error_model="numpy")
def _lag(state: Array, n: int) -> Array:
    """The view (n,) of how far w lags behind a damping that rises by one a second."""
    at = window.HEADER + 2 + N_COUNTERS + n
    return state[at : at + n]


@njit(cache=True, error_model="numpy")
def _covariances(state: Array, n: int, length: int) -> tuple[Array, Array, Array]:
    """The views C (n, n) per unit noise, Q (n, n) of the prior, gains (n, L) by ring slot."""
    at = window.HEADER + 2 + N_COUNTERS + 2 * n
    C = state[at : at + n * n].reshape(n, n)
    Q = state[at + n * n : at + 2 * n * n].reshape(n, n)
    return C, Q, state[at + 2 * n * n : at + 2 * n * n + n * length].reshape(n, length)


@njit(cache=True, error_model="numpy")
def _rings(state: Array, n: int, length: int) -> tuple[Array, Array, Array]:
    """The views velocities (L,), times (L,), samples (2, L) of angle and torque."""
    at = size(n, length) - 4 * length
    samples = state[at + 2 * length : at + 4 * length].reshape(2, length)
    return state[at : at + length], state[at + length : at + 2 * length], samples


@njit(cache=True, error_model="numpy")
def start(par: Array, state: Array) -> None:
    """Overwrite this part of the state with the prior: a damper of constant damping."""
    n = int(par[TERMS]) + 1
    window.start(state)
    state[window.HEADER : size(n, int(par[LENGTH]))] = 0.0
    state[window.HEADER], state[window.HEADER + 1] = par[PRIOR], par[PRIOR_DEVIATION]
    coefficients(state, n)[0] = par[PRIOR]
    Q = _covariances(state, n, int(par[LENGTH]))[1]
    for j in range(n):
        Q[j, j] = _of_prior(par, j)


@njit(cache=True, error_model="numpy")
def _of_prior(par: Array, term: int) -> float:
    """Variance of a coefficient before any data."""
    if term == int(par[TERMS]):
        return 1.0 if par[FRICTION] > 0.0 else 0.0
    return float(par[PRIOR_DEVIATION if term == 0 else BEND_DEVIATION] ** 2)


@njit(cache=True, error_model="numpy")
def enter(par: Array, state: Array, row: Array, psi: Array, held: Array, v: Array) -> int:
    """Take row (3,) = time, angle, torque; the answer says what it makes.

    BAD      nothing: it was skipped
    FILLING  nothing yet: the window is not full
    STILL    no equation: the window tells nothing, or no joint is as fast
    MOVING   the equation v' w = counters[TORQUE], its velocity in counters[SPEED]

    psi (3, L) and held (L,) are overwritten, and v (n,) if MOVING.
    """
    n, length = int(par[TERMS]) + 1, int(par[LENGTH])
    velocities, times, samples = _rings(state, n, length)
    count = counters(state)
    before, first = state[window.LAST], state[window.SAMPLES] == 0.0
    entered = window.admit(state, times, row, 3, par[MAX_GAP])
    if entered == window.SKIPPED:
        return BAD
    count[STEP] = 0.0 if first else max(row[0] - before, 0.0)
    slot = int(state[window.SLOT])
    samples[0, slot], samples[1, slot] = row[1], row[2]
    if entered == window.RESTARTED:
        velocities[:] = 0.0
        _covariances(state, n, length)[2][:, :] = 0.0
    count[REACHED] = max(count[REACHED], velocities[slot])  # of rows that no longer overlap with this one
    velocities[slot] = 0.0
    _covariances(state, n, length)[2][:, slot] = 0.0
    state[window.MOTION] = 0.0
    if state[window.FILLED] < length:
        return FILLING
    state[window.MOTION] = window.spread(samples[0])
    if state[window.MOTION] < par[MINIMUM_MOTION]:
        return STILL
    count[SPAN] = window.weigh(MODULATING_ORDER, times, slot, psi, held)
    speed = -dot(psi[1], samples[0])
    if abs(speed) > FASTEST * par[SCALE]:
        return STILL
    velocities[slot] = abs(speed)
    count[SPEED], count[TORQUE] = speed, dot(psi[0], samples[1])
    ratio = speed / par[SCALE]
    v[0] = speed
    for j in range(1, n - 1):
        v[j] = v[j - 1] * ratio * ratio
    v[n - 1] = par[FRICTION] * speed / sqrt(speed * speed + par[FRICTION_VELOCITY] ** 2)
    return MOVING


@njit(cache=True, error_model="numpy")
def follow(
    par: Array, r: Array, state: Array, error: float, gain: Array, v: Array, lagged: Array, spare: Array
) -> None:
    """Account for w <- w + gain error: what it costs in covariance, and what it tells about the noise.

    r                   (L,) autocorrelation of the window's weights on torque
    error               innovation [N m]
    gain, v             (n,)
    lagged, spare       (L,), (2, n) overwritten
    """
    n, length, slot = int(par[TERMS]) + 1, int(par[LENGTH]), int(state[window.SLOT])
    C, Q, gains = _covariances(state, n, length)
    count = counters(state)
    at = slot
    for d in range(length):
        lagged[at] = r[d]
        at = at - 1 if at > 0 else length - 1
    share = recursive_error.expected(C, gains, v, lagged, spare[0]) + r[0]
    of_prior = recursive_error.quadratic(Q, v)
    if of_prior <= par[NOISE] ** 2 * r[0]:
        count[MISFIT] = MEMORY * count[MISFIT] + error * error
        count[EXPECTED] = MEMORY * count[EXPECTED] + share
    lag = _lag(state, n)
    lag[0] += count[STEP]
    recursive_error.bias(lag, gain, v)
    recursive_error.follow(C, Q, gains, slot, gain, v, spare[0], r[0], spare[1])
    count[TAKEN] += 1.0


@njit(cache=True, error_model="numpy")
def rest(par: Array, state: Array) -> None:
    """One step without an equation: within the rest memory what was learnt fades into the prior's width."""
    n, length = int(par[TERMS]) + 1, int(par[LENGTH])
    keep = exp(-counters(state)[STEP] / par[REST_MEMORY])
    lag = _lag(state, n)
    lag *= keep  # and grows by nothing: what changes meanwhile is the prior's width
    C, Q, _ = _covariances(state, n, length)
    C *= keep
    Q *= keep
    for j in range(n):
        Q[j, j] += (1.0 - keep) * _of_prior(par, j)


@njit(cache=True, error_model="numpy")
def tell(par: Array, r0: float, state: Array, made: int, slope: Array) -> int:
    """Value and deviation of this step into the state; returns its status; slope (n,) is overwritten."""
    n, length = int(par[TERMS]) + 1, int(par[LENGTH])
    now, count = state[window.HEADER : window.HEADER + 2], counters(state)
    if made == BAD:
        return BAD_SAMPLE
    answer = OK
    if count[TAKEN] < length:
        answer = WARMING_UP
    elif made != MOVING:
        answer = NOT_EXCITED
    elif abs(count[SPEED]) > REACH * count[REACHED]:
        answer = OUTSIDE_RANGE
    if answer != WARMING_UP:
        C, Q, _ = _covariances(state, n, length)
        noise = (KNOWN * par[NOISE] ** 2 * r0 + count[MISFIT]) / (KNOWN * r0 + count[EXPECTED])
        w = coefficients(state, n)
        lag = _lag(state, n)
        slope[0], slope[n - 1] = 1.0, 0.0
        for j in range(1, n - 1):
            slope[j] = slope[j - 1] * (count[SPEED] / par[SCALE]) ** 2 * (2 * j + 1) / (2 * j - 1)
        variance = noise * recursive_error.quadratic(C, slope) + recursive_error.quadratic(Q, slope)
        value, late = 0.0, 0.5 * count[SPAN]
        for i in range(n):
            value += slope[i] * w[i]
            late += slope[i] * lag[i]
        # What changed over the last RATE_MEMORY goes on changing, and the estimate lags behind it.
        if count[TAKEN] == length:
            count[SLOW] = value
        count[SLOW] += (value - count[SLOW]) * (1.0 - exp(-count[STEP] / RATE_MEMORY))
        variance += ((value - count[SLOW]) / RATE_MEMORY * late) ** 2
        deviation = sqrt(max(variance, 0.0))
        now[0] = value
        now[1] = deviation if made == MOVING else max(now[1], min(deviation, par[PRIOR_DEVIATION]))
    state[window.STATUS] = answer
    return answer
