"""Detects motors whose measured position stays the same although the torque must move them.

Either the sensor is frozen, or the motor is blocked. A controller would raise the torque to its limit in both cases.
While a position is the same bit by bit, the motor equation gives the travel that the torque causes at least:

    B vdot = net - D v,   net = tau + tau_e(phi) beyond F,   F = share |limit| + error (|tau| + |tau_e|)

F is what dry friction and errors of torques can hold. Beyond TRAVEL, coarser than any encoder, a motor is stalled, and
all motors rest. Torques that never acted look alike, such as commands that a robot lost while it started, and a joint
that rests without torque shows no difference either. So the torque returns after REST, and after twice as long each
time that it moves nothing: what a frozen sensor lets through becomes ever rarer. The rest is REST again once all
positions have changed, or when the controller is switched on or off.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_limits import LimitedArm

TRAVEL = 0.02  # [rad]
REST = 1.0  # [s], the first one
LONGEST_REST = 64.0  # [s]
FRICTION = 0.1  # [-] dry friction over the torque limit
ERROR = 0.2  # [-] error of the torques of motor and spring


@dataclass(frozen=True)
class Stall:
    """State of the detection at the last usable sample."""

    time: float  # [s]
    theta: Array  # (n,) [rad]
    travel: Array  # (2, n) [rad], [rad/s] that the torque must have caused since the position changed last
    until: float = -inf  # [s] end of the rest
    rest: float = REST  # [s] of the next rest


@dataclass(frozen=True, eq=False)
class StallDetection:
    """Detection for the motors of an arm."""

    arm: LimitedArm

    def init(self, sample: ArmSample) -> Stall:
        """The state at the first sample."""
        return Stall(sample.time, sample.theta, np.zeros((2, len(sample.theta))))

    def step(self, state: Stall, sample: ArmSample, applied: Array | None, longest: float) -> Stall:
        """The next state; `applied` (n,) [N m] acted since the last sample, at most `longest` [s] ago; None: zero."""
        step = sample.time - state.time
        travel = state.travel.copy()
        if _forget_moved(travel, state.theta, sample.theta):
            return Stall(sample.time, sample.theta, travel, self._until(state, sample))
        furthest = 0.0
        if applied is not None and 0.0 < step <= longest:
            arm, zeros = self.arm, np.zeros(len(applied))
            tau_e, _ = arm.loads(sample.q, zeros, sample.theta, zeros)
            furthest = _move(travel, step, applied, tau_e, arm.motor_inertia, arm.motor_friction, arm.torque_limit)
        if furthest <= TRAVEL:
            return Stall(sample.time, sample.theta, travel, self._until(state, sample), state.rest)
        rest = min(2.0 * state.rest, LONGEST_REST)
        return Stall(sample.time, sample.theta, np.zeros_like(travel), sample.time + state.rest, rest)

    @staticmethod
    def holds(state: Stall) -> bool:
        """Whether the torque must be zero."""
        return state.time < state.until

    @staticmethod
    def _until(state: Stall, sample: ArmSample) -> float:
        """End of the rest; no later than a whole rest after a stamp that goes backward."""
        return min(state.until, sample.time + state.rest) if sample.time < state.until else -inf


@njit(cache=True, error_model="numpy")
def _forget_moved(travel: Array, before: Array, now: Array) -> bool:
    """Set `travel` (2, n) to zero where a position (n,) has changed; returns whether all have."""
    moved = 0
    for i in range(now.size):
        if now[i] != before[i]:
            travel[0, i] = travel[1, i] = 0.0
            moved += 1
    return moved == now.size


@njit(cache=True, error_model="numpy")
def _move(
    travel: Array, step: float, torque: Array, tau_e: Array, inertia: Array, friction: Array, limit: Array
) -> float:
    """Advance `travel` (2, n) in place, unless all torques are zero; returns the largest one [rad]."""
    furthest, acts = 0.0, torque.any()
    for i in range(torque.size):
        held = ERROR * (abs(torque[i]) + abs(tau_e[i]))
        if np.isfinite(limit[i]):
            held += FRICTION * limit[i]
        net = torque[i] + tau_e[i]
        net = net - held if net > held else net + held if net < -held else 0.0
        if acts:
            travel[1, i] = (travel[1, i] + step * net / inertia[i]) / (1.0 + step * friction[i] / inertia[i])
            travel[0, i] += step * travel[1, i]
        furthest = max(furthest, abs(travel[0, i]))
    return furthest
