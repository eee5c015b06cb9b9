"""What stands between a law and a joint's motors: `supervision` of the joint's axes, and the velocities that it needs.

Velocities are not measured: they are derivatives of angles behind a low pass, which begins anew, from zero, where
`supervision` does. Limits of speed and deflection are therefore late by the low pass's time constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf, nan
from typing import Any

import numpy as np
from via_core.signals import Array, locked

from via_controllers.arm_limits import ArmLimits
from via_controllers.contract import ArmController, ArmSample, Controller, JointSample, require_positive
from via_controllers.hold_joint import HoldJoint
from via_controllers.joint_axes import JointAxes, OnAxes
from via_controllers.low_pass import low_passed
from via_controllers.supervision import FURTHEST, GAP, Answer, Change, Supervised, Supervisor

REACH = 0.98  # of the springs' stops: presets stand close to them


@dataclass(frozen=True)
class SupervisedJoint:
    """Where the supervisor stands, and the motion at the last sample with angles; `time` -inf before it."""

    inner: Supervised
    time: float  # [s]
    angles: Array  # (1 + m,) [rad] link first
    velocities: Array  # (1 + m,) [rad/s]


@dataclass(frozen=True, eq=False)
class JointSupervisor:
    """A law of a joint, what holds the joint still, and the limits. Raises ParameterError for a bandwidth <= 0."""

    supervisor: Supervisor
    velocity_bandwidth: float = 500.0  # [rad/s]
    _n: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        require_positive(self, "velocity_bandwidth")
        object.__setattr__(self, "_n", self.supervisor.limits.arm.n)

    @classmethod
    def of(
        cls, law: Controller[Any], axes: JointAxes, begin: Callable[[], Any] | None = None, drive: float = 0.5
    ) -> JointSupervisor:
        """The usual limits and the usual way to hold still; `begin` as in OnAxes.

        drive  share of their speed limit up to which the law may drive motors; all of it leaves none to follow links
        """
        speed = max(drive, ArmLimits.speed_share)
        limits = ArmLimits(axes, drive_share=drive, speed_share=speed, deflection_share=REACH)
        return cls(Supervisor(OnAxes(law, begin), HoldJoint(axes), limits))

    @property
    def law(self) -> ArmController[Any]:
        """Who decides while active."""
        return self.supervisor.law

    @property
    def limits(self) -> ArmLimits:
        """What is kept."""
        return self.supervisor.limits

    def init(self) -> SupervisedJoint:
        """Before the first sample."""
        nothing = locked(np.zeros(1 + self._n), "angles")
        return SupervisedJoint(self.supervisor.init(), -inf, nothing, nothing)

    def step(self, state: SupervisedJoint, sample: JointSample, active: bool) -> tuple[SupervisedJoint, Answer]:
        """The answer to `sample`, and the next state."""
        angles = np.array([sample.q, *sample.theta])
        velocities = self._velocities(state, sample.time, angles)
        motion = ArmSample(
            sample.time, np.full(self._n, angles[0]), np.full(self._n, velocities[0]), angles[1:], velocities[1:],
            np.full(self._n, nan),
        )  # fmt: skip
        inner, answer = self.supervisor.step(state.inner, motion, active)
        if inner is state.inner:
            return state, answer  # a sample that cannot be used
        return SupervisedJoint(inner, sample.time, locked(angles, "angles"), locked(velocities, "velocities")), answer

    def informed(self, state: SupervisedJoint, change: Change) -> SupervisedJoint:
        """As `Supervisor.informed`."""
        return replace(state, inner=self.supervisor.informed(state.inner, change))

    def told(self, state: SupervisedJoint) -> Array:
        """What the law tells (k,), NaN while it does not decide."""
        return self.supervisor.told(state.inner)

    def _velocities(self, state: SupervisedJoint, time: float, angles: Array) -> Array:
        step = time - state.time
        if not (0.0 <= step <= GAP and np.abs(angles).max() <= FURTHEST):  # no joint is there: of no use
            return np.zeros(1 + self._n)
        return low_passed(state.velocities, state.angles, angles, step, self.velocity_bandwidth)
