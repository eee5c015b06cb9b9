"""Selects what drives an arm's motors: the controller, the holding controller, or nothing.

    active, usable sample      the controller                        ACTIVE
    inactive, usable sample    the holding controller                HOLDING
    unusable sample            no torque, see `measured_motion`      PASSIVE
    motors that do not follow  no torque, see `following`            PASSIVE
    the controller fails       no torque                             PASSIVE

Controllers and limits get the sample as it will be when its torques act (`delay`). Limits are enforced in every case. A
controller restarts with the first sample after it is selected, after a stamp that goes backward, and after a gap,
because its state no longer fits the motion. For joints see `joint_supervision`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from math import isfinite
from typing import Any

import numpy as np
from via_core.signals import Array

from via_controllers.contract import ArmController, ArmSample, require
from via_controllers.supervision.arm_limits import LIMITS, TORQUE, ArmLimits, Limit
from via_controllers.supervision.delay import Sent, ahead, mean_torque, steps_of, still_acting
from via_controllers.supervision.following import Following, FollowingDetection
from via_controllers.supervision.measured_motion import MeasuredMotion, fault_of

GAP = 0.02  # [s] between two samples after which a controller restarts
Change = Callable[[Any], Any]  # of a controller's state
LOST = (
    "a motor does not follow its torque: its sensor is frozen, wrong or reversed, the motor is blocked, or commands "
    "act too late"
)


class Activity(IntEnum):
    """What drives the motors."""

    PASSIVE = 0
    HOLDING = 1
    ACTIVE = 2


@dataclass(frozen=True)
class Answer:
    """Motor torques for one sample."""

    torque: Array  # (n,) [N m]
    activity: Activity
    limited: Limit
    unusable: bool = False  # whether the sample cannot be the arm's motion, or the controller failed on it
    fault: str = ""  # why there is no torque


@dataclass(frozen=True)
class Supervised:
    """State of a Supervisor."""

    deciding: Activity = Activity.PASSIVE  # at the last usable sample
    inner: Any = None  # state of the controller that ran then
    time: float = -np.inf  # [s] of the last usable sample
    torque: Array | None = None  # (n,) [N m] that acts since then; None: no torque
    sent: tuple[Sent, ...] = ()  # commands that act after the last sample, with a delay
    following: Following | None = None
    motion: MeasuredMotion | None = None
    active: bool = False


@dataclass(frozen=True, eq=False)
class Supervisor:
    """A controller, a holding controller and the limits of an arm, whose torques act `delay` [s] after stamps.

    Raises ParameterError for a negative delay, or one over which the motors cannot be predicted.
    """

    controller: ArmController[Any]
    holding: ArmController[Any]
    limits: ArmLimits
    delay: float = 0.0
    _followed: FollowingDetection = field(init=False, repr=False)
    _steps: int = field(init=False, repr=False)  # of a prediction

    def __post_init__(self) -> None:
        require(self.delay >= 0.0, f"delay must be >= 0 s, got {self.delay}")
        object.__setattr__(self, "_followed", FollowingDetection(self.limits.arm))
        object.__setattr__(self, "_steps", steps_of(self.limits.arm, self.delay) if self.delay > 0.0 else 1)

    def init(self) -> Supervised:
        """The state before the first sample."""
        return Supervised()

    def step(self, state: Supervised, sample: ArmSample, active: bool, acts: bool = True) -> tuple[Supervised, Answer]:
        """The next state and the torques for `sample`; `acts`: whether they will act, or come too late."""
        after, answer = self._answered(state, sample, active, acts)
        if self.delay > 0.0 and isfinite(sample.time):
            torque = answer.torque if acts else np.zeros(self.limits.arm.n)
            after = replace(after, sent=(*self._acting(state, sample.time), Sent(sample.time, torque)))
        return after, answer

    def _answered(self, state: Supervised, sample: ArmSample, active: bool, acts: bool) -> tuple[Supervised, Answer]:
        fault = fault_of(sample, self.limits.arm)
        if fault:
            return state, self._without(fault)
        motion, fault = state.motion.next(sample, GAP) if state.motion else (MeasuredMotion.of(sample), "")
        following = self._following(state, sample, active)
        waiting = Supervised(time=sample.time, following=following, motion=motion, active=active)
        if fault:
            return waiting, self._without(fault)
        if self._followed.holds(following):
            return waiting, replace(self.passive(), fault=LOST)
        deciding, controller = (Activity.ACTIVE, self.controller) if active else (Activity.HOLDING, self.holding)
        continued = state.deciding is deciding and 0.0 <= sample.time - state.time <= GAP
        try:
            seen, limited = sample, motion.corrected
            if self.delay > 0.0:
                arm = (controller.model(state.inner) if continued else None) or self.limits.arm
                sent = self._acting(state, sample.time)
                seen, limited = (ahead(arm, each, sent, self.delay, self._steps) for each in (seen, limited))
            inner, out = controller.step(state.inner if continued else controller.init(seen), seen)
        except Exception as error:  # whatever fails in it, the node lives and the motors get no torque
            return waiting, self._without(f"the controller fails on a sample: {type(error).__name__}: {error}")
        step = sample.time - state.time
        torque, changed = self.limits.kept(limited, out.torque, step if 0.0 < step <= GAP else 0.0)
        if out.saturated:
            changed = LIMITS[changed | TORQUE]
        applied = torque if acts else None
        state = replace(waiting, deciding=deciding, inner=inner, torque=applied)
        return state, Answer(torque, deciding, changed)

    def passive(self) -> Answer:
        """No torque."""
        return Answer(np.zeros(self.limits.arm.n), Activity.PASSIVE, Limit.NONE)

    def _without(self, fault: str) -> Answer:
        return replace(self.passive(), unusable=True, fault=fault)

    def _acting(self, state: Supervised, time: float) -> tuple[Sent, ...]:
        """The commands that act after a sample at `time` [s]; none after a gap, or a stamp that goes backward."""
        recent = state.sent and 0.0 <= time - state.sent[-1].stamp <= GAP
        return still_acting(state.sent, time, self.delay) if recent else ()

    def _following(self, state: Supervised, sample: ArmSample, active: bool) -> Following:
        if state.following is None or active != state.active:
            return self._followed.init(sample)
        torque = state.torque
        if self.delay > 0.0 and torque is not None and sample.time > state.time:
            torque = np.zeros(len(torque)) + mean_torque(state.sent, state.time, sample.time, self.delay)
        return self._followed.step(state.following, sample, torque, GAP)

    def updated(self, state: Supervised, change: Change) -> Supervised:
        """`state` with `change` applied to the controller's state; unchanged while the controller is not active."""
        return replace(state, inner=change(state.inner)) if state.deciding is Activity.ACTIVE else state

    def observe(self, state: Supervised) -> Array:
        """Quantities (k,) of the controller, NaN while it is not active."""
        if state.deciding is Activity.ACTIVE:
            return self.controller.observe(state.inner)
        return np.full(len(self.controller.quantities), np.nan)
