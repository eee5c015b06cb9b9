"""Payload of an arm of flexible joints, and friction of its links, from motor torques and motion of links and motors.

The equations of links and motors, (9) and (10), added joint by joint do not contain the springs:

    M qdd + C qd + Dq qd + g + B thdd + D thd + F sign(thd) = tau,   Mdot = C + C'

M, C and g are linear in a point mass m at the tip. With the momentum p = M qd + B thd = p_0 + m p_1

    d/dt (p_0 + m p_1) = C_0' qd - Dq qd - g_0 - D thd + m (C_1' qd - g_1) - c qd - F sign(thd) + tau

is multiplied by a modulating function psi and integrated by parts, so that no acceleration is needed. Velocities are
those between two samples, at the mean angles: velocities of drivers are filtered, and their unknown delay would look
like friction. Joint by joint

    <-p_0, psi'> - <f_0, psi> - <tau, psi> = m (<p_1, psi'> + <f_1, psi>) - c <qd, psi> - F <sign(thd), psi>

with f_0 = C_0' qd - Dq qd - g_0 - D thd and f_1 = C_1' qd - g_1. Unknowns x are m and, of each joint, the viscous
friction c of the link and the dry friction F of the motor beyond those of the arm's file. They follow from a Kalman
filter with two equations per joint and window. The equations hold under any controller: a controller that uses the
payload does not disturb its estimate.

- The noise r_i^2 of each joint's equation is measured by the difference of its innovations to those of the window l two
  earlier, which ends where window k begins: d = y_k - y_l - (A_k - A_l) x. Without a change it has the variance
  2 r_i^2 + (A_k - A_l) P (A_k - A_l)'. What lasts cancels: a force, or the friction of a motor at rest. Whenever the
  noise of an equation changes, the variance of the unknowns that it determines is scaled by the same ratio, at most up
  to that before any data.
- A hand or a wall at the tip is a force that no mass explains: what an equation's innovations e contain besides the
  direction a of a mass, v = (e' S^-1 e - g) / (n - 1) with g = (a' S^-1 e)^2 / (a' S^-1 a), is 1 on average. Above 1,
  this window's noise is larger by that factor. A force lasts for many windows and is not averaged away: the share of
  (v - 1) / (a' S^-1 a), what it may look like as a mass, that enters with m is added to the variance. A force that acts
  on every joint as a weight does is a payload.
- Where more than MISFIT of the torques remains unexplained, a channel is wrong or a strong force acts: IMPLAUSIBLE.
- A payload that is picked up or put down: g has one degree of freedom. Above JUMP^2 the variance of m grows by what
  the innovation exceeds it by.
- A motor at rest may bear its dry friction in either direction, which is noise.

Source: our own; momentum form of A. De Luca and R. Mattone, ICRA 2005 (sensorless collision detection), modulating
functions as in the SAPHARI deliverable 'Control and estimation algorithms for VIA robots', Section 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import BAD_SAMPLE, IMPLAUSIBLE, NOT_EXCITED, OK, WARMING_UP
from via_core.vsa_arms import VsaArm

from via_estimators import window
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.slots import row_of, slots
from via_estimators.window import HEADER

SIGNALS = ("q", "theta", "tau")  # of each joint; effort as in `modulated_torque`
ROWS_PER_WINDOW = 2  # as in `modulated_torque`
ORDER = 5  # h of the modulating function w_hh
NOISE_MEMORY = 40.0  # equations over which noise is measured
NOISE_WEIGHT = 2.0  # equations that the declared noise counts for
JUMP = 4.0  # standard deviations of an innovation that shows another payload
EARLIEST = 3.0  # windows before the first estimate
INFORMED = 0.5  # over the prior's standard deviation: no better estimate is NOT_EXCITED
SURE = 3.0  # standard deviations beyond an impossible payload
P = slots(
    "length", "max_gap", "noise", "payload_deviation", "damping_deviation", "friction_deviation", "payload_drift",
    "still", "lightest", "heaviest",
)  # fmt: skip
ACROSS = 0.05  # of a window: time before and after, over which the direction of a motor is measured
MISFIT, FADING = 0.3, 0.8  # share of the torques from which a misfit is IMPLAUSIBLE; factor on it per window
SHORTEST = 1e-5  # [s] between samples: closer ones are one that was sent twice
ROUNDING, TINY = 1e-7, 1e-24  # of its torques, and [N^2 m^2]: below, an equation has no noise
# Samples since the last window; windows taken; windows since a gap; time of the last one [s]; variance of m due to
# forces [kg^2]; share of the squared torques that is not explained, the largest one, fading.
HEAD = slots("since", "taken", "steady", "before", "forces", "misfit")
# Means over the interval since the previous sample; theta is the motor's angle at its end.
PART = slots("momentum", "force", "unit_momentum", "unit_force", "velocity", "theta", "tau")


@dataclass(frozen=True)
class PayloadParameters(Parameters):
    """Parameters of `Payload`."""

    window: int = parameter(200, "sampling intervals per window", "-", 20, 2000)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the window", "s", 1e-4, 10.0)
    noise: float = parameter(0.05, "expected standard deviation of an equation's torque", "N m", 1e-9, 1e6)
    payload_deviation: float = parameter(1.0, "standard deviation of the payload before any data", "kg", 1e-6, 1e4)
    damping_deviation: float = parameter(0.5, "standard deviation of links' viscous friction", "N m s/rad", 1e-9, 1e4)
    friction_deviation: float = parameter(0.5, "standard deviation of motors' dry friction", "N m", 1e-9, 1e4)
    payload_drift: float = parameter(0.003, "change of the payload in a second", "kg", 0.0, 1e3)
    still: float = parameter(0.01, "velocity below which a motor may be stuck", "rad/s", 0.0, 10.0)
    lightest: float = parameter(-0.5, "least possible payload: the arm may be lighter than its file", "kg", -1e4, 0.0)
    heaviest: float = parameter(10.0, "largest possible payload", "kg", 0.0, 1e4)


@dataclass(frozen=True, eq=False)
class Payload(Estimator):
    """The payload of `arm` [kg], and the viscous friction of each link beyond the file's [N m s/rad], base first."""

    arm: VsaArm
    parameters: PayloadParameters = PayloadParameters()
    _loaded: VsaArm = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_loaded", self.arm.corrected(1.0, np.ones(self.arm.n)))

    @classmethod
    def from_device(cls, device: Device) -> Payload:
        """A payload belongs to an arm: use `Payload(arm)`."""
        raise ParameterError(f"'{device.name}' is a joint; the payload is that of an arm")

    def with_parameters(self, parameters: Parameters) -> Payload:
        return replace(self, parameters=expect(parameters, PayloadParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return tuple(f"{name}_{joint}" for name in SIGNALS for joint in range(1, self.arm.n + 1))

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("payload", *(f"link_friction_{joint}" for joint in range(1, self.arm.n + 1)))

    @cached_property
    def _constants(self) -> Array:
        return row_of(P, self.parameters, length=self.parameters.window + 1)

    def init(self) -> Array:
        own, n, length = self.parameters, self.arm.n, self.parameters.window + 1
        state = np.zeros(_angles_at(n, length) + 2 * n)
        window.start(state)
        value, sd = window.outputs(state, 1 + n)
        value[:], sd[0], sd[1:] = 0.0, own.payload_deviation, own.damping_deviation
        _, variance, noise, weight, _ = _filter(state, n)
        variance[np.diag_indices(1 + 2 * n)] = np.concatenate(
            [[own.payload_deviation**2], np.full(n, own.damping_deviation**2), np.full(n, own.friction_deviation**2)]
        )
        noise[:], weight[:] = own.noise**2, NOISE_WEIGHT
        state.setflags(write=False)
        return state

    @property
    def _advance(self) -> Kernel:
        return self._fold_rows

    def _fold_rows(self, state: Array, rows: Array, out: Array) -> int:
        """Momentum and forces of each interval by pinocchio, then the compiled fold of one sample."""
        status, n, length = BAD_SAMPLE, self.arm.n, self.parameters.window + 1
        before = state[_angles_at(n, length) :].reshape(2, n)
        for row, written in zip(rows, out, strict=True):
            sample, step = row[1:].reshape(len(SIGNALS), n), float(row[0] - state[HEADER.last])
            followed = state[HEADER.samples] > 0.0 and 0.0 < step <= self.parameters.max_gap
            parts = self._parts(before if followed else sample[:2], sample, step)
            if followed and step < SHORTEST:
                parts[:] = np.nan
            status = _take(state, float(row[0]), parts, self._constants, written)
            if status != BAD_SAMPLE:
                before[:] = sample[:2]
        return status

    def _parts(self, before: Array, sample: Array, step: float) -> Array:
        """(PART.size, n) of a sample (3, n), `step` [s] after the angles `before` (2, n) of links and motors."""
        parts = np.full((PART.size, self.arm.n), np.nan)
        if not np.isfinite(sample).all() or np.abs(sample).max() > window.LARGEST:
            return parts
        arm, loaded, (_, theta, tau) = self.arm, self._loaded, sample
        v, w = (sample[:2] - before) / step if step > 0.0 else np.zeros((2, arm.n))
        q = 0.5 * (before[0] + sample[0])
        momentum, force = arm.inertia(q) @ v, arm.coriolis(q, v).T @ v - arm.gravity(q)
        heavier, pushed = loaded.inertia(q) @ v, loaded.coriolis(q, v).T @ v - loaded.gravity(q)
        parts[PART.momentum] = momentum + arm.motor_inertia * w
        parts[PART.force] = force - arm.link_friction * v - arm.motor_friction * w
        parts[PART.unit_momentum], parts[PART.unit_force] = heavier - momentum, pushed - force
        parts[PART.velocity], parts[PART.theta], parts[PART.tau] = v, theta, tau
        return parts

    def condition(self, state: Array) -> float:
        """Condition number [-] of the unknowns' covariance in units of their prior."""
        own, n = self.parameters, self.arm.n
        variance = _filter(state, n)[1]
        scale = np.concatenate(
            [[own.payload_deviation], np.full(n, own.damping_deviation), np.full(n, own.friction_deviation)]
        )
        return float(np.linalg.cond(variance / np.outer(scale, scale)))


@njit(cache=True, error_model="numpy")
def _head_at(n: int) -> int:
    """Position of HEAD, after the header, 1 + n outputs and their standard deviations."""
    return HEADER.size + 2 * (1 + n)


@njit(cache=True, error_model="numpy")
def _ring_at(n: int) -> int:
    """Position of the ring buffer, after header, outputs, HEAD and the arrays of `_filter`."""
    k = 1 + 2 * n
    return _head_at(n) + HEAD.size + k + k * k + 2 * n + 2 * n * (2 + k)


@njit(cache=True, error_model="numpy")
def _angles_at(n: int, length: int) -> int:
    """Position of the last angles of links and motors (2, n), after the ring buffer."""
    return _ring_at(n) + length * (1 + PART.size * n)


@njit(cache=True, error_model="numpy")
def _filter(state: Array, n: int) -> tuple[Array, Array, Array, Array, Array]:
    """Views: x (1 + 2 n,); its covariance; noise r^2 (n,) [N^2 m^2]; by how many equations (n,); earlier equations.

    The last are (2, n, 3 + 2 n), the latest first: y, <1, psi> of the motor at rest, and the row of A.
    """
    k, at = 1 + 2 * n, _head_at(n) + HEAD.size
    x, variance = state[at : at + k], state[at + k : at + k + k * k].reshape(k, k)
    at += k + k * k
    earlier = state[at + 2 * n : at + 2 * n + 2 * n * (2 + k)].reshape(2, n, 2 + k)
    return x, variance, state[at : at + n], state[at + n : at + 2 * n], earlier


@njit(cache=True, error_model="numpy")
def _take(state: Array, time: float, parts: Array, own: Array, out: Array) -> int:
    """One sample with its parts (PART.size, n); writes the output row (4 + 2 n,) and returns the status."""
    n, length = parts.shape[1], int(own[P.length])
    times, columns = window.rings(state, _ring_at(n), length, parts.size)
    row = np.empty(1 + parts.size)
    row[0], row[1:] = time, parts.ravel()
    entered = window.admit(state, times, row, row.size, own[P.max_gap])
    if entered == window.SKIPPED:
        window.answer(state, BAD_SAMPLE, out)
        return BAD_SAMPLE
    head = state[_head_at(n) : _head_at(n) + HEAD.size]
    slot = int(state[HEADER.slot])
    columns[:, slot] = row[1:]
    head[HEAD.since] = 0.0 if entered == window.RESTARTED else head[HEAD.since] + 1.0
    if entered == window.RESTARTED:
        head[HEAD.steady] = 0.0
    full = state[HEADER.filled] == length
    if full and head[HEAD.since] >= (length - 1) // ROWS_PER_WINDOW:
        head[HEAD.since] = 0.0
        _window(state, times, columns.reshape(PART.size, n, length), own)
        head[HEAD.taken] += 1.0
        head[HEAD.steady] += 1.0
    x, variance, _, _, _ = _filter(state, n)
    value, sd = window.outputs(state, 1 + n)
    status = WARMING_UP
    if head[HEAD.taken] >= EARLIEST:
        passed = max(time - head[HEAD.before], 0.0)
        value[:] = x[: 1 + n]
        for i in range(n + 1):
            sd[i] = np.sqrt(variance[i, i])
        sd[0] = np.sqrt(variance[0, 0] + head[HEAD.forces] + own[P.payload_drift] ** 2 * passed)
        status = OK
        if sd[0] > INFORMED * own[P.payload_deviation]:
            status = NOT_EXCITED
        elif value[0] + SURE * sd[0] < own[P.lightest] or value[0] - SURE * sd[0] > own[P.heaviest]:
            status = IMPLAUSIBLE
        if head[HEAD.misfit] > MISFIT**2:
            status = IMPLAUSIBLE
    state[HEADER.status] = status
    window.answer(state, status, out)
    return status


@njit(cache=True, error_model="numpy")
def _window(state: Array, times: Array, columns: Array, own: Array) -> None:
    """Add the equations of the full window to the filter."""
    n, length = columns.shape[1], times.size
    psi, held, slope = np.empty((3, length)), np.empty(length), np.empty(length)
    newest = int(state[HEADER.slot])
    window.weigh(ORDER, times, newest, psi, held)
    window.hold_slope(times, newest, psi[0], slope)
    head = state[_head_at(n) : _head_at(n) + HEAD.size]
    x, variance, noise, weight, earlier = _filter(state, n)
    passed = max(times[newest] - head[HEAD.before], 0.0) if head[HEAD.taken] > 0.0 else 0.0
    head[HEAD.before] = times[newest]
    variance[0, 0] += own[P.payload_drift] ** 2 * passed
    A, y, R, rest, torques = np.zeros((n, x.size)), np.empty(n), np.empty(n), np.empty(n), 0.0
    for i in range(n):
        A[i, 0] = slope @ columns[PART.unit_momentum, i] + held @ columns[PART.unit_force, i]
        A[i, 1 + i] = -(held @ columns[PART.velocity, i])
        direction, rest[i] = _directions(times, columns[PART.theta, i], newest, psi[0], own[P.still])
        A[i, 1 + n + i] = -direction
        torque = held @ columns[PART.tau, i]
        y[i] = -(slope @ columns[PART.momentum, i]) - held @ columns[PART.force, i] - torque
        torques += torque**2
        noise[i] = max(noise[i], ROUNDING**2 * (torque**2 + y[i] ** 2) + TINY)
        R[i] = noise[i] + _borne(x, variance, i, n) * rest[i] ** 2
    e = y - A @ x
    S = A @ variance @ A.T + np.diag(R)
    weighted, along = np.linalg.solve(S, e), np.linalg.solve(S, np.ascontiguousarray(A[:, 0]))
    information = along @ A[:, 0]
    mass = (along @ e) / information if information > 0.0 else 0.0
    explained = mass**2 * information
    unexplained = (e @ weighted - explained) / max(n - 1, 1)
    more = max(unexplained, 1.0) if n > 1 else 1.0
    if explained > JUMP**2 * more:
        variance[0, 0] += mass**2 - 1.0 / information
    scale = np.ones(x.size)
    for i in range(n):
        if head[HEAD.steady] >= earlier.shape[0]:
            row = A[i] - earlier[1, i, 2:]
            change, count, before = y[i] - earlier[1, i, 0] - row @ x, min(weight[i], NOISE_MEMORY), noise[i]
            expected = 2.0 * before + row @ (variance @ row)
            expected += _borne(x, variance, i, n) * (rest[i] - earlier[1, i, 1]) ** 2
            noise[i] *= (count + min(change**2 / expected, JUMP**2)) / (count + 1.0)
            weight[i] = count + 1.0
            factor = 1.0 + (noise[i] - before) / R[i]
            share = A[i, 0] * along[i] / information if information > 0.0 else 0.0
            scale[0] += share * (factor - 1.0)
            scale[1 + i] = scale[1 + n + i] = factor
        earlier[1, i] = earlier[0, i]
        earlier[0, i, 0], earlier[0, i, 1], earlier[0, i, 2:] = y[i], rest[i], A[i]
        R[i] *= more
    for i in range(x.size):
        first = own[P.payload_deviation] if i == 0 else own[P.damping_deviation if i <= n else P.friction_deviation]
        scale[i] = np.sqrt(max(min(scale[i], max(first**2 / variance[i, i], 1.0)), 0.0))
    variance[:, :] *= np.outer(scale, scale)
    S = A @ variance @ A.T + np.diag(R)
    if information > 0.0:
        moved = min(variance[0, 0] * (A[:, 0] @ np.linalg.solve(S, np.ascontiguousarray(A[:, 0]))), 1.0)
        head[HEAD.forces] += moved * ((more - 1.0) / information - head[HEAD.forces])
    gain = np.linalg.solve(S, A @ variance).T
    x += gain @ e
    variance -= gain @ (A @ variance)
    variance[:, :] = 0.5 * (variance + variance.T)
    left = y - A @ x
    share = (left @ left) / torques if torques > 0.0 else 0.0
    head[HEAD.misfit] = max(min(share, 1.0), FADING * head[HEAD.misfit])


@njit(cache=True, error_model="numpy")
def _borne(x: Array, variance: Array, i: int, n: int) -> float:
    """Mean square [N^2 m^2] of the dry friction of motor i, which it bears at rest in either direction."""
    return float(x[1 + n + i] ** 2 + variance[1 + n + i, 1 + n + i])


@njit(cache=True, error_model="numpy")
def _directions(times: Array, theta: Array, newest: int, weights: Array, still: float) -> tuple[float, float]:
    """<sign(thd), psi> of a motor, and <1, psi> over the times at which it is no faster than `still` [rad/s].

    Angles (L,) are compared over ACROSS of the window before and after: neighbours differ by steps of the encoder.
    """
    length, direction, stuck = times.size, 0.0, 0.0
    far = max(int(ACROSS * length), 1)
    for k in range(length):
        late, early = newest - max(k - far, 0), newest - min(k + far, length - 1)
        speed = (theta[late] - theta[early]) / (times[late] - times[early])  # negative positions count from the end
        if abs(speed) <= still:
            stuck += weights[newest - k]
        else:
            direction += weights[newest - k] * np.sign(speed)
    return direction, stuck
