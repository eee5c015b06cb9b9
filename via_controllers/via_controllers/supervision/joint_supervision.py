"""Selects what drives a joint's motors: `supervision` of the joint's axes, with estimated velocities.

Velocities are not measured: they are derivatives of angles behind a low pass, which restarts from zero when
`supervision` restarts. Limits of speed and deflection are therefore delayed by the time constant of the low pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Any

import numpy as np
from via_core.signals import Array, locked

from via_controllers.contract import ArmController, ArmSample, Controller, JointSample, require_positive
from via_controllers.joint_axes import JointAxes, OnAxes
from via_controllers.low_pass import low_passed
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import FURTHEST, GAP, Answer, Change, Supervised, Supervisor
from via_controllers.supervision.hold_joint import HoldJoint

REACH = 0.98  # deflection limit over the springs' stops: presets are close to the stops


@dataclass(frozen=True)
class SupervisedJoint:
    """State of a JointSupervisor and the motion at the last usable sample."""

    inner: Supervised
    time: float  # [s], -inf before the first sample
    angles: Array  # (1 + m,) [rad] link first
    velocities: Array  # (1 + m,) [rad/s]


@dataclass(frozen=True, eq=False)
class JointSupervisor:
    """A controller, a holding controller and the limits of a joint. Raises ParameterError for a bandwidth <= 0."""

    supervisor: Supervisor
    velocity_bandwidth: float = 500.0  # [rad/s]

    def __post_init__(self) -> None:
        require_positive(self, "velocity_bandwidth")

    @classmethod
    def of(
        cls, controller: Controller[Any], axes: JointAxes, start: Callable[[], Any] | None = None, drive: float = 0.5
    ) -> JointSupervisor:
        """With `HoldJoint` and the default limits.

        start  returns the controller's initial state; None: `controller.init`
        drive  share of their speed limit that the controller may use; with 1 none is left to follow an accelerated link
        """
        speed = max(drive, ArmLimits.speed_share)
        limits = ArmLimits(axes, drive_share=drive, speed_share=speed, deflection_share=REACH)
        return cls(Supervisor(OnAxes(controller, start), HoldJoint(axes), limits))

    @property
    def controller(self) -> ArmController[Any]:
        """What runs while active."""
        return self.supervisor.controller

    @property
    def limits(self) -> ArmLimits:
        """The limits enforced on torques."""
        return self.supervisor.limits

    def init(self) -> SupervisedJoint:
        """The state before the first sample."""
        zeros = locked(np.zeros(1 + self.limits.arm.n), "angles")
        return SupervisedJoint(self.supervisor.init(), -inf, zeros, zeros)

    def step(self, state: SupervisedJoint, sample: JointSample, active: bool) -> tuple[SupervisedJoint, Answer]:
        """The next state and the torques for `sample`."""
        angles, n = np.array([sample.q, *sample.theta]), self.limits.arm.n
        velocities = self._velocities(state, sample.time, angles)
        q, q_velocity, unknown = (np.array([value] * n) for value in (angles[0], velocities[0], nan))
        motion = ArmSample(sample.time, q, q_velocity, angles[1:], velocities[1:], unknown)
        inner, answer = self.supervisor.step(state.inner, motion, active)
        if answer.unusable:
            return state, answer
        return SupervisedJoint(inner, sample.time, locked(angles, "angles"), locked(velocities, "velocities")), answer

    def passive(self) -> Answer:
        """No torque."""
        return self.supervisor.passive()

    def updated(self, state: SupervisedJoint, change: Change) -> SupervisedJoint:
        """As `Supervisor.updated`."""
        return replace(state, inner=self.supervisor.updated(state.inner, change))

    def observe(self, state: SupervisedJoint) -> Array:
        """Quantities (k,) of the controller, NaN while it is not active."""
        return self.supervisor.observe(state.inner)

    def _velocities(self, state: SupervisedJoint, time: float, angles: Array) -> Array:
        step = time - state.time
        if not (0.0 <= step <= GAP and np.abs(angles).max() <= FURTHEST):  # restart, or a measurement fault
            return np.zeros(1 + self.limits.arm.n)
        return low_passed(state.velocities, state.angles, angles, step, self.velocity_bandwidth)
