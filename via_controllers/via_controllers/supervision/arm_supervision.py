"""Selects what drives an arm's motors: the controller, the holding controller, or nothing.

    active, usable sample      the controller                        ACTIVE
    inactive, usable sample    the holding controller                HOLDING
    unusable sample            no torque                             PASSIVE
    stalled motor              no torque, see `stall`                PASSIVE

Limits are enforced in every case. A controller restarts with the first sample after it is selected, after a stamp that
goes backward, and after a gap, because its state no longer fits the motion. For joints see `joint_supervision`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmController, ArmSample
from via_controllers.supervision.arm_limits import LIMITS, TORQUE, ArmLimits, Limit
from via_controllers.supervision.stall import Stall, StallDetection

GAP = 0.02  # [s] between two samples after which a controller restarts
Change = Callable[[Any], Any]  # of a controller's state
FURTHEST, FASTEST = 1e2, 1e3  # [rad], [rad/s]: larger values are measurement faults


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
    stalled: bool = False  # whether a motor does not follow its torque
    unusable: bool = False  # whether a value is missing or impossible


@dataclass(frozen=True)
class Supervised:
    """State of a Supervisor."""

    deciding: Activity = Activity.PASSIVE  # at the last usable sample
    inner: Any = None  # state of the controller that ran then
    time: float = -np.inf  # [s] of the last usable sample
    torque: Array | None = None  # (n,) [N m] that acts since then; None: no torque
    stall: Stall | None = None
    active: bool = False


@dataclass(frozen=True, eq=False)
class Supervisor:
    """A controller, a holding controller and the limits of an arm."""

    controller: ArmController[Any]
    holding: ArmController[Any]
    limits: ArmLimits
    _stalls: StallDetection = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_stalls", StallDetection(self.limits.arm))

    def init(self) -> Supervised:
        """The state before the first sample."""
        return Supervised()

    def step(self, state: Supervised, sample: ArmSample, active: bool, acts: bool = True) -> tuple[Supervised, Answer]:
        """The next state and the torques for `sample`; `acts`: whether they will act, or come too late."""
        if not _usable(sample.time, sample.q, sample.theta, sample.q_velocity, sample.theta_velocity):
            return state, replace(self.passive(), unusable=True)
        stall = self._stall(state, sample, active)
        if self._stalls.holds(stall):
            waiting = Supervised(time=sample.time, stall=stall, active=active)
            return waiting, replace(self.passive(), stalled=True)
        deciding, controller = (Activity.ACTIVE, self.controller) if active else (Activity.HOLDING, self.holding)
        continued = state.deciding is deciding and 0.0 <= sample.time - state.time <= GAP
        inner, out = controller.step(state.inner if continued else controller.init(sample), sample)
        torque, changed = self.limits.kept(sample, out.torque)
        if out.saturated:
            changed = LIMITS[changed | TORQUE]
        applied = torque if acts else None
        return Supervised(deciding, inner, sample.time, applied, stall, active), Answer(torque, deciding, changed)

    def passive(self) -> Answer:
        """No torque."""
        return Answer(np.zeros(self.limits.arm.n), Activity.PASSIVE, Limit.NONE)

    def _stall(self, state: Supervised, sample: ArmSample, active: bool) -> Stall:
        if state.stall is None or active != state.active:
            return self._stalls.init(sample)
        return self._stalls.step(state.stall, sample, state.torque, GAP)

    def updated(self, state: Supervised, change: Change) -> Supervised:
        """`state` with `change` applied to the controller's state; unchanged while the controller is not active."""
        return replace(state, inner=change(state.inner)) if state.deciding is Activity.ACTIVE else state

    def observe(self, state: Supervised) -> Array:
        """Quantities (k,) of the controller, NaN while it is not active."""
        if state.deciding is Activity.ACTIVE:
            return self.controller.observe(state.inner)
        return np.full(len(self.controller.quantities), np.nan)


@njit(cache=True, error_model="numpy")
def _usable(time: float, q: Array, theta: Array, q_velocity: Array, theta_velocity: Array) -> bool:
    """Whether all values are finite and possible."""
    usable = np.isfinite(time)
    for i in range(q.size):
        usable &= abs(q[i]) <= FURTHEST and abs(theta[i]) <= FURTHEST
        usable &= abs(q_velocity[i]) <= FASTEST and abs(theta_velocity[i]) <= FASTEST
    return bool(usable)
