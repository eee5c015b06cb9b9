"""What stands between a law and an arm's motors: when the law decides, when the arm is held, when nothing drives it.

    active, usable sample      the law                       ACTIVE
    inactive, usable sample    the arm held where it was     HOLDING
    anything else              no torque                     PASSIVE

Limits are kept in every case. A law starts anew with its first sample, when it becomes active, after stamps that go
backward and after a gap: what it knew of the motion is then wrong. For joints see `joint_supervision`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.arm_limits import ArmLimits, Limit
from via_controllers.contract import ArmController, ArmSample, blind

GAP = 0.02  # [s] between two samples after which a law starts anew
Change = Callable[[Any], Any]  # of a law's state
FURTHEST, FASTEST = 1e2, 1e3  # [rad], [rad/s]: no joint is there, a sample that says so is wrong


class Activity(IntEnum):
    """Who decides."""

    PASSIVE = 0
    HOLDING = 1
    ACTIVE = 2


@dataclass(frozen=True)
class Answer:
    """What goes to the motors after a sample."""

    torque: Array  # (n,) [N m]
    activity: Activity
    limited: Limit


@dataclass(frozen=True)
class Supervised:
    """`deciding` is who decided last, `inner` that law's state."""

    deciding: Activity = Activity.PASSIVE
    inner: Any = None
    time: float = -np.inf  # [s] of the last usable sample


@dataclass(frozen=True, eq=False)
class Supervisor:
    """A law, what holds the arm in its place, and the limits."""

    law: ArmController[Any]
    still: ArmController[Any]
    limits: ArmLimits

    def init(self) -> Supervised:
        """Before the first sample."""
        return Supervised()

    def step(self, state: Supervised, sample: ArmSample, active: bool) -> tuple[Supervised, Answer]:
        """The answer to `sample`, and the next state."""
        nothing = np.zeros(len(sample.q))
        if not _usable(sample):
            return state, Answer(nothing, Activity.PASSIVE, Limit.NONE)
        deciding, law = (Activity.ACTIVE, self.law) if active else (Activity.HOLDING, self.still)
        goes_on = state.deciding is deciding and 0.0 <= sample.time - state.time <= GAP
        inner = state.inner if goes_on else law.init(sample)
        inner, out = law.step(inner, sample)
        torque, changed = self.limits.kept(sample, out.torque)
        if out.saturated:
            changed |= Limit.TORQUE
        return Supervised(deciding, inner, sample.time), Answer(torque, deciding, changed)

    def informed(self, state: Supervised, change: Change) -> Supervised:
        """The state in which the law knows something that no sample says; as it was where the law does not decide."""
        return replace(state, inner=change(state.inner)) if state.deciding is Activity.ACTIVE else state

    def told(self, state: Supervised) -> Array:
        """What the law tells (k,), NaN while it does not decide."""
        if state.deciding is Activity.ACTIVE:
            return self.law.told(state.inner)
        return np.full(len(self.law.quantities), np.nan)


def _usable(sample: ArmSample) -> bool:
    if blind(sample):
        return False
    return _near(sample.q, sample.theta, FURTHEST) and _near(sample.q_velocity, sample.theta_velocity, FASTEST)


@njit(cache=True, error_model="numpy")
def _near(first: Array, second: Array, most: float) -> bool:
    furthest = 0.0
    for i in range(first.size):
        furthest = max(furthest, abs(first[i]), abs(second[i]))
    return furthest <= most
