"""Detects motors that do not follow their torque.

A sensor may be frozen, flicker, count the wrong way or jump, or the motor is blocked. A controller would raise the
torque to its limit in all these cases. A model of each motor follows the measured angle with any friction f up to F:

    B vdot = tau + tau_e(phi) - D v + f,   |f| <= F = share |limit| + error (|tau| + |tau_e|)

F is what dry friction and errors of torques can explain. Where the best f leaves the model further than APART from the
measurement, the motor does not follow. If all angles repeat bit by bit, a smaller torque shows it too: a motor that
moved by more than its encoder resolves cannot have stopped within one sample by F and the torques on it.

All motors rest then. Torques that never acted look alike, such as commands that a robot lost while it started. So the
torque returns after REST, and after twice as long each time that motors do not follow: what a wrong sensor lets through
becomes ever rarer. The rest is REST again once the motors have followed for as long as the last rest, or when the
controller is switched on or off.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_limits import LimitedArm

APART = 0.05  # [rad]: nearly twice what a switch between the torque limits of qbmove_a leaves that acts 5 ms late
FRICTION = 0.1  # [-] dry friction over the torque limit
ERROR = 0.2  # [-] error of the torques of motor and spring
REST = 1.0  # [s], the first one
LONGEST_REST = 64.0  # [s]
FROZEN = 0.02  # [s] for which angles repeat bit by bit, longer than slow drivers repeat a sample
RESOLVED = 3.0  # times the smallest change of an angle: slow motion changes it by one or two encoder steps
AHEAD, SPEED, FINEST, PACE = range(4)  # rows of `Following.motion`


@dataclass(frozen=True)
class Following:
    """State at the last usable sample.

    motion  (4, n): the model's lead [rad] and speed [rad/s] (NaN: not known yet), the smallest change of the angle so
            far [rad], and the one before it began to repeat, over what F can stop [-]
    since   [s] of the sample that all angles have repeated from then on
    until   [s] end of the rest
    rest    [s] length of the next rest
    """

    time: float  # [s]
    q: Array  # (n,) [rad]
    theta: Array  # (n,) [rad]
    motion: Array
    since: float
    until: float = -inf
    rest: float = REST


@dataclass(frozen=True, eq=False)
class FollowingDetection:
    """Detection for the motors of an arm."""

    arm: LimitedArm
    _zeros: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_zeros", np.zeros(self.arm.n))

    def init(self, sample: ArmSample) -> Following:
        """The state at the first sample."""
        motion = np.array([[0.0], [np.nan], [inf], [0.0]]) * np.ones(self.arm.n)
        return Following(sample.time, sample.q, sample.theta, motion, sample.time)

    def step(self, state: Following, sample: ArmSample, applied: Array | None, longest: float) -> Following:
        """The next state; `applied` (n,) [N m] acted since the last sample, at most `longest` [s] ago; None: zero."""
        step, motion, arm = sample.time - state.time, state.motion.copy(), self.arm
        if applied is None or not 0.0 < step <= longest or not applied.any():
            motion[AHEAD], motion[SPEED], motion[PACE] = 0.0, np.nan, 0.0
            return self._next(state, sample, motion, sample.time, False)
        tau_e, _ = arm.loads(sample.q, self._zeros, sample.theta, self._zeros)
        equal = np.array_equal(sample.theta, state.theta) and np.array_equal(sample.q, state.q)
        furthest, stopped = _follow(
            motion, step, state.theta, sample.theta, equal, applied, tau_e,
            arm.motor_inertia, arm.motor_friction, arm.torque_limit,
        )  # fmt: skip
        since = state.since if equal else sample.time
        frozen = equal and stopped > 1.0 and sample.time - since >= FROZEN
        return self._next(state, sample, motion, since, furthest > APART or frozen)

    @staticmethod
    def holds(state: Following) -> bool:
        """Whether the torque must be zero."""
        return state.time < state.until

    def _next(self, state: Following, sample: ArmSample, motion: Array, since: float, lost: bool) -> Following:
        until, rest = state.until, state.rest
        if lost:
            fresh = self.init(sample)
            motion[[AHEAD, SPEED, PACE]] = fresh.motion[[AHEAD, SPEED, PACE]]
            until, rest = sample.time + rest, min(2.0 * rest, LONGEST_REST)
        elif until > sample.time + rest:  # a stamp that goes backward
            until = sample.time + rest
        elif sample.time - until > rest:
            rest = REST
        return replace(
            state, time=sample.time, q=sample.q, theta=sample.theta, motion=motion, since=since, until=until, rest=rest
        )


@njit(cache=True, error_model="numpy")
def _follow(
    motion: Array, step: float, before: Array, now: Array, equal: bool, torque: Array, tau_e: Array,
    inertia: Array, friction: Array, limit: Array,
) -> tuple[float, float]:  # fmt: skip
    """Advance `motion` (4, n) in place; the largest lead [rad], and largest PACE [-] of a resolved motion."""
    furthest = stopped = 0.0
    for i in range(torque.size):
        held = ERROR * (abs(torque[i]) + abs(tau_e[i]))
        if np.isfinite(limit[i]):
            held += FRICTION * limit[i]
        moved, net = now[i] - before[i], torque[i] + tau_e[i]
        pace, behind = moved / step, -motion[AHEAD, i]
        speed = motion[SPEED, i] if np.isfinite(motion[SPEED, i]) else pace
        damped = 1.0 + step * friction[i] / inertia[i]
        free, room = (speed + step * net / inertia[i]) / damped, step * held / inertia[i] / damped
        # the speed that ends the lead without passing the measured angle, at half of what F allows
        catch = min(abs(behind) / step, np.sqrt(held / inertia[i] * abs(behind)))
        wanted = pace + catch if behind > 0.0 else pace - catch
        motion[SPEED, i] = min(max(wanted, free - room), free + room)
        motion[AHEAD, i] += step * motion[SPEED, i] - moved
        furthest = max(furthest, abs(motion[AHEAD, i]))
        if moved != 0.0:
            motion[FINEST, i] = min(motion[FINEST, i], abs(moved))
        if not equal:
            resolved = abs(moved) > RESOLVED * motion[FINEST, i]
            brake = step * (held + abs(net)) / inertia[i]
            motion[PACE, i] = abs(pace) / brake if resolved and brake > 0.0 else 0.0
        stopped = max(stopped, motion[PACE, i])
    return furthest, stopped
