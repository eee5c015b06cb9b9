"""An arm or a joint together with its controller, limits and holding controller: what one controller node drives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from via_core.errors import ParameterError
from via_core.parameters import parameter
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_core.wire import command_name, link_name, motor_name

from via_controllers.contract import ArmController, ArmSample, JointSample
from via_controllers.joint_axes import JointAxes
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import Supervisor
from via_controllers.supervision.hold_still import HoldStill
from via_controllers.supervision.joint_supervision import JointSupervisor


class Reading(NamedTuple):
    """What a sample needs of a JointState.

    joints    that the message must name
    entries   array of the message and joint of each of the k numbers
    required  so many first numbers must be there
    """

    joints: tuple[str, ...]
    entries: tuple[tuple[str, str], ...]
    required: int


@dataclass(frozen=True, eq=False)
class ControlledArm:
    """An arm under its supervisor; `joints` are named base first."""

    name: str
    joints: tuple[str, ...]
    supervisor: Supervisor

    damping = 0.0  # an arm has no dampers

    @classmethod
    def with_holding(cls, arm: VsaArm, controller: ArmController[Any], delay: float = 0.0) -> ControlledArm:
        """The arm with this controller, the default limits and `HoldStill`; torques act `delay` [s] after stamps."""
        return cls(arm.name, arm.joints, Supervisor(controller, HoldStill(arm), ArmLimits(arm), delay))

    @property
    def command_name(self) -> str:
        """Topic of the arm's commands, relative to the namespace of its nodes."""
        return command_name(self.name)

    @property
    def reading(self) -> Reading:
        """What `sample` needs of a message: one that names all links and motors, with their angles and velocities."""
        links = tuple(link_name(joint) for joint in self.joints)
        motors = tuple(motor_name(joint, 1) for joint in self.joints)
        motion = [(field, name) for names in (links, motors) for field in ("position", "velocity") for name in names]
        torques = [("effort", link) for link in links]  # of sensors, which may be missing
        return Reading((*links, *motors), (*motion, *torques), len(motion))

    def sample(self, row: Array) -> ArmSample:
        """The sample from a row (1 + k,): time [s] and the numbers of `reading`."""
        return ArmSample(float(row[0]), *row[1:].reshape(5, -1).copy())


@dataclass(frozen=True, eq=False)
class ControlledJoint:
    """A joint under its supervisor."""

    axes: JointAxes
    supervisor: JointSupervisor

    @property
    def name(self) -> str:
        """Name of the device, as in topics."""
        return self.axes.device.name

    @property
    def damping(self) -> float:
        """Damper command [0..1] of every message."""
        return self.axes.damping

    @property
    def command_name(self) -> str:
        """Topic of the device's commands, as in `Device`."""
        return self.axes.device.command_name

    @property
    def reading(self) -> Reading:
        """What `sample` needs of a message: the angles; only the link must be named."""
        link, motors = self.axes.device.link_joint, self.axes.device.motor_joints
        return Reading((link,), tuple(("position", name) for name in (link, *motors)), 1 + len(motors))

    def sample(self, row: Array) -> JointSample:
        """The sample from a row (1 + k,), as for an arm."""
        return JointSample(float(row[0]), float(row[1]), row[2:].copy())


Controlled = ControlledArm | ControlledJoint


def zero_sample(robot: Controlled, time: float) -> Any:
    """A sample at `time` [s] with every number zero, to load compiled functions with."""
    return robot.sample(np.array([time, *[0.0] * len(robot.reading.entries)]))


@dataclass(frozen=True)
class ControllerParameters(ABC):
    """Parameters of every controller node."""

    autostart: bool = parameter(True, "configure and activate at start-up")
    told_every: int = parameter(1, "number of samples per ControlState message", "", (1, 1_000_000))
    delay: float = parameter(
        0.0, "time from a sample's stamp until its torque acts; the motion is predicted", "s", (0.0, 0.1)
    )

    def tuned(self, supervisor: Any) -> Any:
        """The supervisor with `delay` and the controller's live parameters; what holds the robot is not changed."""
        if "controller" in {each.name for each in fields(supervisor)}:
            return replace(supervisor, controller=self._with_live(supervisor.controller), delay=self.delay)
        return replace(supervisor, supervisor=self.tuned(supervisor.supervisor))

    def _with_live(self, part: Any) -> Any:
        """The dataclass `part` with the live parameters in all its fields of the same name."""
        live = {each.name for each in fields(self) if each.metadata.get("live")}
        changed = {}
        for each in fields(part):
            value = getattr(part, each.name)
            inner = self._with_live(value) if is_dataclass(value) else value
            new = getattr(self, each.name) if each.name in live else inner
            if new is not value:
                changed[each.name] = new
        return replace(part, **changed) if changed else part

    def shared(self, controller: type) -> dict[str, Any]:
        """The parameters that are fields of the same name in `controller`."""
        return {each.name: getattr(self, each.name) for each in fields(controller) if hasattr(self, each.name)}

    @abstractmethod
    def build(self) -> Controlled:
        """The robot with its controller; raises ParameterError or DeviceError."""


def joint_values(name: str, values: tuple[float, ...], arm: VsaArm) -> Array:
    """Parameter `name` as an array (n,), one number per joint; raises ParameterError for another count."""
    if len(values) != arm.n:
        raise ParameterError(f"parameter {name} must hold {arm.n} numbers, got {list(values)}")
    return np.array(values, dtype=float)
