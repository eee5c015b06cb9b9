"""Equation of a joint's damping by its dissipation torque: rows, statuses and standard deviations for any solver.

Source: SAPHARI deliverable, Section 5.1, eqs. (56)-(61): the dissipation torque is odd in the deflection velocity,

    tau_d = v' w,   v_j = s (zd/s)^(2j-1),   D = dtau_d/dzd = sum_j (2j-1) (zd/s)^(2j-2) w_j,

with the document's powers for s = 1 rad/s; another s gives every w_j the unit N m s/rad and reduces the weight of P and
its growth on higher powers. There is one more unknown,

    w_F F zd / sqrt(zd^2 + v_F^2)

dry friction as a multiple of what the device may have (F; with F = 0 only the document's powers remain). It is odd too,
but no damping and not part of D. Without it, powers absorb friction: F sign(zd) appears as about F / |zd| of damping,
so that the estimate rises at each reversal, twice per period of the motion (document: errors of 5 to 30 %).

No velocity is measured, and a difference of encoder samples would be noise (.1 rad/s at 16 bit and 1 kHz). Angle and
torque therefore pass the same short modulating function psi = w_55,

    zd = <zd, psi> = -<z, psi'>,   tau_d = <tau_d, psi>,

by the weights of via_core.weak_form on the actual stamps. The two have the same phase, so a delay between them cannot
appear as damping: exact for the linear term, and up to (T zdd)^2 / 17 relative to zd^2 for the cubic one. All is half a
window late. On a rigid joint whose motor is fixed the deflection z is the link angle q.

The variance (`recursive_error`) includes noise, measured by the last thousand innovations of rows dominated by it; the
remaining part of the prior; and the lag behind a damping that changes as the estimate did over the last .3 s. Not
included: friction beyond its unknown (a Stribeck peak), and all friction if F = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import Any

from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import BAD_SAMPLE, NOT_EXCITED, OK, OUTSIDE_RANGE, WARMING_UP

from via_estimators import recursive_error, window
from via_estimators.coloured import colours, dot
from via_estimators.contract import Parameters, parameter
from via_estimators.slots import slots
from via_estimators.window import HEADER

MODULATING_ORDER = 5
MOST_TERMS = 3
FASTEST = 1e3  # [velocity scales] larger velocities are ignored
REACH = 1.02  # velocities up to this multiple of the largest one visited count as visited
RATE_MEMORY = 0.3  # [s] over which the change of damping is measured
MEMORY = 0.999  # of innovations, per row
KNOWN = 1.0  # weight of the declared noise, in independent innovations
P = slots(
    "length", "terms", "max_gap", "velocity_scale", "minimum_motion", "torque_noise", "damping_prior",
    "damping_deviation", "bend_deviation", "dry_friction", "friction_velocity", "rest_memory", "covariance_limit",
)  # fmt: skip
# Sums of squared innovations and of their variances per unit noise; rows taken; largest velocity visited; velocity and
# torque of the last row; span of its window [s]; step to the last sample [s]; low-passed damping.
LATEST = slots("misfit", "expected", "taken", "reached", "velocity", "torque", "span", "step", "slow_damping")
MOVING, STILL, FILLING, BAD = range(4)  # results of `enter`


@dataclass(frozen=True)
class DampingParameters(Parameters):
    """Parameters of every solver of this equation."""

    window: int = parameter(40, "sampling intervals per window", "-", 10, 500)
    terms: int = parameter(1, "odd powers of the velocity, n", "-", 1, MOST_TERMS)
    velocity_scale: float = parameter(4.0, "velocity at which all powers have equal weight", "rad/s", 1e-3, 1e3)
    damping_prior: float = parameter(0.0, "damping before any data, w(0)", "N m s/rad", 0.0, 1e6)
    damping_deviation: float = parameter(5.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e6)
    bend_deviation: float = parameter(
        0.5, "standard deviation of the coefficients of higher powers", "N m s/rad", 1e-9, 1e6
    )
    rest_memory: float = parameter(10.0, "time at rest after which the past has weight 1/e", "s", 1e-3, 1e9)
    dry_friction: float = parameter(0.05, "standard deviation of dry friction before any data", "N m", 0.0, 1e6)
    friction_velocity: float = parameter(
        0.05, "velocity at which dry friction is 71 % of its limit", "rad/s", 1e-6, 1e3
    )
    torque_noise: float = parameter(0.05, "expected standard deviation of torque noise", "N m", 1e-9, 1e6)
    minimum_motion: float = parameter(4e-4, "least range of angle in an informative window", "rad", 0.0, 1.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    initial_covariance: float = parameter(10.0, "covariance before any data, P(0)", "1/(rad/s)^2", 1e-9, 1e9)
    covariance_limit: float = parameter(
        10.0, "mean variance at which P no longer grows, p_max", "1/(rad/s)^2", 1e-9, 1e12
    )

    def colour(self) -> Array:
        """Autocorrelation (L,) of the window's weights on torque."""
        return colours(self.window, MODULATING_ORDER)[0].copy()


def known_of(device: Device) -> dict[str, Any]:
    """Parameters from a device file: the damper's range as prior, dry friction, sensor noise and quantum.

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
        "dry_friction": device.link.coulomb_friction or sensors.link_torque_noise,  # less is not observable
        "torque_noise": max(sensors.link_torque_noise, 1e-9),
    }
    if sensors.link_quantum is not None:
        known["minimum_motion"] = 4.0 * sensors.link_quantum
    return known


@njit(cache=True, error_model="numpy")
def size(n: int, length: int) -> int:
    """Size of the state: header, value, standard deviation, LATEST, w, lag, C, Q, gains, velocities, times, samples."""
    return HEADER.size + 2 + LATEST.size + 2 * n + 2 * n * n + n * length + 4 * length


@njit(cache=True, error_model="numpy")
def latest_of(state: Array) -> Array:
    """The view (LATEST.size,) of sums and latest values."""
    return state[HEADER.size + 2 : HEADER.size + 2 + LATEST.size]


@njit(cache=True, error_model="numpy")
def coefficients(state: Array, n: int) -> Array:
    """The view w (n,) [N m s/rad]."""
    at = HEADER.size + 2 + LATEST.size
    return state[at : at + n]


@njit(cache=True, error_model="numpy")
def _lag(state: Array, n: int) -> Array:
    """The view (n,) of the lag of w behind a damping that rises by one per second."""
    at = HEADER.size + 2 + LATEST.size + n
    return state[at : at + n]


@njit(cache=True, error_model="numpy")
def _covariances(state: Array, n: int, length: int) -> tuple[Array, Array, Array]:
    """The views C (n, n) per unit noise, Q (n, n) of the prior, gains (n, L) by ring slot."""
    at = HEADER.size + 2 + LATEST.size + 2 * n
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
    n = int(par[P.terms]) + 1
    window.start(state)
    state[HEADER.size : size(n, int(par[P.length]))] = 0.0
    state[HEADER.size], state[HEADER.size + 1] = par[P.damping_prior], par[P.damping_deviation]
    coefficients(state, n)[0] = par[P.damping_prior]
    Q = _covariances(state, n, int(par[P.length]))[1]
    for j in range(n):
        Q[j, j] = _of_prior(par, j)


@njit(cache=True, error_model="numpy")
def _of_prior(par: Array, term: int) -> float:
    """Variance of a coefficient before any data."""
    if term == int(par[P.terms]):
        return 1.0 if par[P.dry_friction] > 0.0 else 0.0
    return float(par[P.damping_deviation if term == 0 else P.bend_deviation] ** 2)


@njit(cache=True, error_model="numpy")
def enter(par: Array, state: Array, row: Array, psi: Array, held: Array, v: Array) -> int:
    """Process a sample row (3,) = time, angle, torque.

    BAD      the sample was skipped
    FILLING  the window is not full yet
    STILL    no equation: the window is not informative, or the velocity is not plausible
    MOVING   the equation v' w = LATEST.torque, its velocity in LATEST.velocity

    psi (3, L) and held (L,) are overwritten, and v (n,) if MOVING.
    """
    n, length = int(par[P.terms]) + 1, int(par[P.length])
    velocities, times, samples = _rings(state, n, length)
    latest = latest_of(state)
    before, first = state[HEADER.last], state[HEADER.samples] == 0.0
    entered = window.admit(state, times, row, 3, par[P.max_gap])
    if entered == window.SKIPPED:
        return BAD
    latest[LATEST.step] = 0.0 if first else max(row[0] - before, 0.0)
    slot = int(state[HEADER.slot])
    samples[0, slot], samples[1, slot] = row[1], row[2]
    if entered == window.RESTARTED:
        velocities[:] = 0.0
        _covariances(state, n, length)[2][:, :] = 0.0
    # Only velocities of rows that no longer overlap with this one count as visited.
    latest[LATEST.reached] = max(latest[LATEST.reached], velocities[slot])
    velocities[slot] = 0.0
    _covariances(state, n, length)[2][:, slot] = 0.0
    state[HEADER.motion] = 0.0
    if state[HEADER.filled] < length:
        return FILLING
    state[HEADER.motion] = window.span_of(samples[0])
    if state[HEADER.motion] < par[P.minimum_motion]:
        return STILL
    latest[LATEST.span] = window.weigh(MODULATING_ORDER, times, slot, psi, held)
    speed = -dot(psi[1], samples[0])
    if abs(speed) > FASTEST * par[P.velocity_scale]:
        return STILL
    velocities[slot] = abs(speed)
    latest[LATEST.velocity], latest[LATEST.torque] = speed, dot(psi[0], samples[1])
    ratio = speed / par[P.velocity_scale]
    v[0] = speed
    for j in range(1, n - 1):
        v[j] = v[j - 1] * ratio * ratio
    v[n - 1] = par[P.dry_friction] * speed / sqrt(speed * speed + par[P.friction_velocity] ** 2)
    return MOVING


@njit(cache=True, error_model="numpy")
def follow(
    par: Array, r: Array, state: Array, error: float, gain: Array, v: Array, lagged: Array, spare: Array
) -> None:
    """Update covariance, lag and noise after w <- w + gain error.

    r                   (L,) autocorrelation of the window's weights on torque
    error               innovation [N m]
    gain, v             (n,)
    lagged, spare       (L,), (2, n) overwritten
    """
    n, length, slot = int(par[P.terms]) + 1, int(par[P.length]), int(state[HEADER.slot])
    C, Q, gains = _covariances(state, n, length)
    latest = latest_of(state)
    at = slot
    for d in range(length):
        lagged[at] = r[d]
        at = at - 1 if at > 0 else length - 1
    share = recursive_error.expected(C, gains, v, lagged, spare[0]) + r[0]
    of_prior = recursive_error.quadratic(Q, v)
    if of_prior <= par[P.torque_noise] ** 2 * r[0]:
        latest[LATEST.misfit] = MEMORY * latest[LATEST.misfit] + error * error
        latest[LATEST.expected] = MEMORY * latest[LATEST.expected] + share
    lag = _lag(state, n)
    lag[0] += latest[LATEST.step]
    recursive_error.bias(lag, gain, v)
    recursive_error.follow(C, Q, gains, slot, gain, v, spare[0], r[0], spare[1])
    latest[LATEST.taken] += 1.0


@njit(cache=True, error_model="numpy")
def rest(par: Array, state: Array) -> None:
    """One step without an equation: the estimate's covariance approaches the prior's within the rest memory."""
    n, length = int(par[P.terms]) + 1, int(par[P.length])
    keep = exp(-latest_of(state)[LATEST.step] / par[P.rest_memory])
    lag = _lag(state, n)
    lag *= keep  # changes at rest are included in the prior's variance
    C, Q, _ = _covariances(state, n, length)
    C *= keep
    Q *= keep
    for j in range(n):
        Q[j, j] += (1.0 - keep) * _of_prior(par, j)


@njit(cache=True, error_model="numpy")
def report(par: Array, r0: float, state: Array, made: int, slope: Array) -> int:
    """Write value and standard deviation of this step into the state; returns the status; slope (n,) is overwritten."""
    n, length = int(par[P.terms]) + 1, int(par[P.length])
    now, latest = state[HEADER.size : HEADER.size + 2], latest_of(state)
    if made == BAD:
        return BAD_SAMPLE
    answer = OK
    if latest[LATEST.taken] < length:
        answer = WARMING_UP
    elif made != MOVING:
        answer = NOT_EXCITED
    elif abs(latest[LATEST.velocity]) > REACH * latest[LATEST.reached]:
        answer = OUTSIDE_RANGE
    if answer != WARMING_UP:
        C, Q, _ = _covariances(state, n, length)
        noise = (KNOWN * par[P.torque_noise] ** 2 * r0 + latest[LATEST.misfit]) / (KNOWN * r0 + latest[LATEST.expected])
        w = coefficients(state, n)
        lag = _lag(state, n)
        slope[0], slope[n - 1] = 1.0, 0.0
        for j in range(1, n - 1):
            slope[j] = slope[j - 1] * (latest[LATEST.velocity] / par[P.velocity_scale]) ** 2 * (2 * j + 1) / (2 * j - 1)
        variance = noise * recursive_error.quadratic(C, slope) + recursive_error.quadratic(Q, slope)
        value, late = 0.0, 0.5 * latest[LATEST.span]
        for i in range(n):
            value += slope[i] * w[i]
            late += slope[i] * lag[i]
        # The change over the last RATE_MEMORY is assumed to continue, and the estimate lags behind it.
        if latest[LATEST.taken] == length:
            latest[LATEST.slow_damping] = value
        forgotten = 1.0 - exp(-latest[LATEST.step] / RATE_MEMORY)
        latest[LATEST.slow_damping] += (value - latest[LATEST.slow_damping]) * forgotten
        variance += ((value - latest[LATEST.slow_damping]) / RATE_MEMORY * late) ** 2
        sd = sqrt(max(variance, 0.0))
        now[0] = value
        now[1] = sd if made == MOVING else max(now[1], min(sd, par[P.damping_deviation]))
    state[HEADER.status] = answer
    return answer
