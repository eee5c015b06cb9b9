"""Detects motors whose measured position stays the same although the torque must move them.

Either the sensor is frozen, or the motor is blocked. A controller would raise the torque to its limit in both cases.
While a position is the same bit by bit, the motor equation gives the travel that the torque causes at least:

    B vdot = net - D v,   net = tau + tau_e(phi) beyond F,   F = share |limit| + error (|tau| + |tau_e|)

F is what dry friction and errors of torques can hold. Beyond TRAVEL, coarser than any encoder, the motor is stalled. It
recovers when its position changes, at the earliest after REST, or when the controller is switched on or off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_limits import LimitedArm

TRAVEL = 0.02  # [rad]
REST = 0.5  # [s]
FRICTION = 0.1  # [-] dry friction over the torque limit
ERROR = 0.2  # [-] error of the torques of motor and spring


@dataclass(frozen=True)
class Stall:
    """State of the detection at the last usable sample."""

    time: float  # [s]
    theta: Array  # (n,) [rad]
    travel: Array  # (2, n) [rad], [rad/s] that the torque must have caused since the position changed last
    stalled: Array  # (n,) whether the position has not changed since the motor was found stalled
    until: float = -inf  # [s] end of the rest


@dataclass(frozen=True, eq=False)
class StallDetection:
    """Detection for the motors of an arm."""

    arm: LimitedArm

    def init(self, sample: ArmSample) -> Stall:
        """The state at the first sample."""
        n = len(sample.theta)
        return Stall(sample.time, sample.theta, np.zeros((2, n)), np.zeros(n, dtype=bool))

    def step(self, state: Stall, sample: ArmSample, applied: Array, longest: float) -> Stall:
        """The next state; `applied` (n,) [N m] acted since the last sample, at most `longest` [s] ago."""
        moved, step = sample.theta != state.theta, sample.time - state.time
        if moved.all():
            return replace(self.init(sample), until=self._until(state, sample))
        travel, stalled = np.where(moved, 0.0, state.travel), state.stalled & ~moved
        if 0.0 < step <= longest and applied.any():
            arm, zeros = self.arm, np.zeros(len(moved))
            tau_e, _ = arm.loads(sample.q, zeros, sample.theta, zeros)
            _move(travel, step, applied, tau_e, arm.motor_inertia, arm.motor_friction, arm.torque_limit)
        found = np.abs(travel[0]) > TRAVEL
        until = sample.time + REST if found.any() else self._until(state, sample)
        travel[:, found] = 0.0
        return Stall(sample.time, sample.theta, travel, stalled | found, until)

    @staticmethod
    def holds(state: Stall) -> bool:
        """Whether the torque must be zero."""
        return state.time < state.until or bool(state.stalled.any())

    @staticmethod
    def _until(state: Stall, sample: ArmSample) -> float:
        """End of the rest; no later than REST after a stamp that goes backward."""
        return min(state.until, sample.time + REST) if sample.time < state.until else -inf


@njit(cache=True, error_model="numpy")
def _move(
    travel: Array, step: float, torque: Array, tau_e: Array, inertia: Array, friction: Array, limit: Array
) -> None:
    """Advance `travel` (2, n) in place."""
    for i in range(torque.size):
        held = ERROR * (abs(torque[i]) + abs(tau_e[i]))
        if np.isfinite(limit[i]):
            held += FRICTION * limit[i]
        net = torque[i] + tau_e[i]
        net = net - held if net > held else net + held if net < -held else 0.0
        travel[1, i] = (travel[1, i] + step * net / inertia[i]) / (1.0 + step * friction[i] / inertia[i])
        travel[0, i] += step * travel[1, i]
