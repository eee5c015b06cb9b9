"""Selects what drives a joint's motors: `supervision` of the joint's axes, with estimated velocities.

Velocities are not measured: they are derivatives of angles behind a low pass, which restarts from zero when
`supervision` restarts. Limits of speed and deflection are therefore delayed by the time constant of the low pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, nan
from typing import Any

import numpy as np
from numba import njit
from via_core.signals import Array, locked

from via_controllers.contract import ArmController, ArmSample, Controller, JointSample, require_positive
from via_controllers.joint_axes import JointAxes, OnAxes
from via_controllers.low_pass import low_passed
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import GAP, Answer, Change, Supervised, Supervisor
from via_controllers.supervision.hold_joint import HoldJoint
from via_controllers.supervision.measured_motion import FURTHEST

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
        cls, controller: Controller[Any], axes: JointAxes, initial: Callable[[], Any] | None = None, drive: float = 0.5
    ) -> JointSupervisor:
        """The supervisor with `HoldJoint` and the default limits.

        initial  returns the controller's initial state; None: `controller.init`
        drive    share of their speed limit that the controller may use; with 1 none is left to follow a fast link
        """
        speed = max(drive, ArmLimits.speed_share)
        limits = ArmLimits(axes, drive_share=drive, speed_share=speed, deflection_share=REACH)
        return cls(Supervisor(OnAxes(controller, initial), HoldJoint(axes), limits))

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

    def step(
        self, state: SupervisedJoint, sample: JointSample, active: bool, acts: bool = True
    ) -> tuple[SupervisedJoint, Answer]:
        """As `Supervisor.step`."""
        step, out = sample.time - state.time, np.zeros((4, 1 + self.limits.arm.n))
        _move(out, sample.q, sample.theta, step, state.angles, state.velocities, self.velocity_bandwidth)
        angles, velocities, q, q_velocity = out
        motion = ArmSample(sample.time, q[1:], q_velocity[1:], angles[1:], velocities[1:], self._unknown)
        inner, answer = self.supervisor.step(state.inner, motion, active, acts)
        if answer.unusable:
            remembered = inner.sent is state.inner.sent
            return state if remembered else replace(state, inner=replace(state.inner, sent=inner.sent)), answer
        out.flags.writeable = angles.flags.writeable = velocities.flags.writeable = False
        return SupervisedJoint(inner, sample.time, angles, velocities), answer

    def passive(self) -> Answer:
        """No torque."""
        return self.supervisor.passive()

    def updated(self, state: SupervisedJoint, change: Change) -> SupervisedJoint:
        """As `Supervisor.updated`."""
        return replace(state, inner=self.supervisor.updated(state.inner, change))

    def observe(self, state: SupervisedJoint) -> Array:
        """Quantities (k,) of the controller, NaN while it is not active."""
        return self.supervisor.observe(state.inner)

    @cached_property
    def _unknown(self) -> Array:
        """Torques (m,) of sensors, which joints do not have."""
        return locked(np.full(self.limits.arm.n, nan), "spring_torque")


@njit(cache=True, error_model="numpy")
def _move(out: Array, q: float, theta: Array, step: float, before: Array, velocities: Array, bandwidth: float) -> None:
    """Write the motion (4, 1 + m): angles and velocities, link first, and those of the link once more for each motor.

    out         zeros
    step        [s] since the last sample, whose angles and velocities were `before` and `velocities`
    """
    angles, velocity = out[0], out[1]
    angles[0], angles[1:] = q, theta
    if 0.0 <= step <= GAP and np.abs(angles).max() <= FURTHEST:  # else a restart, or a measurement fault
        velocity[:] = low_passed(velocities, before, angles, step, bandwidth)
    out[2], out[3] = q, velocity[0]
