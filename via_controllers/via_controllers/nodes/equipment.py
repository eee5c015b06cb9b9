"""What a node of a law controls and how: an arm, a joint; one description for `controller`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_core.wire import command_topic
from via_ros.arms import ArmReader
from via_ros.conversions import Joints, RowReader

from via_controllers.arm_limits import ArmLimits
from via_controllers.contract import ArmController, ArmSample, Controller, JointSample
from via_controllers.hold_still import HoldStill
from via_controllers.joint_axes import JointAxes
from via_controllers.joint_supervision import JointSupervisor
from via_controllers.supervision import Answer, Change, Supervisor


@dataclass(frozen=True)
class StartParameters:
    """Parameters of every such node."""

    autostart: bool = field(default=True, metadata={"description": "configure and activate without being asked"})
    told_every: int = field(
        default=1, metadata={"description": "samples from one ControlState to the next", "range": (1, 1_000_000)}
    )


@dataclass(frozen=True)
class ArmParameters(StartParameters):
    """Parameters of those that control an arm from a file."""

    arm: str = field(default="reference_4dof", metadata={"description": "arm name or path to its YAML"})


class Ears(Protocol):
    """Finds samples in messages."""

    @property
    def malformed(self) -> int:
        """Arrays that did not fit their names, so far."""

    def heard(self, joints: Joints) -> tuple[int, Any] | None:
        """Stamp [ns] and sample of a message; None where it is not about what is controlled."""


class Supervising(Protocol):
    """`Supervisor` and `JointSupervisor`."""

    @property
    def law(self) -> ArmController[Any]: ...
    @property
    def limits(self) -> ArmLimits: ...
    def init(self) -> Any: ...
    def step(self, state: Any, sample: Any, active: bool) -> tuple[Any, Answer]: ...
    def informed(self, state: Any, change: Change) -> Any: ...
    def told(self, state: Any) -> Array: ...


@dataclass(frozen=True, eq=False)
class Input:
    """A topic beside the samples that a law wants to hear."""

    kind: Any  # class of its messages
    topic: str
    qos: Any
    heard: Callable[[Any], None]


@dataclass(frozen=True, eq=False)
class Equipment:
    """What a node controls and how."""

    name: str  # of the arm or the device, as in topics
    command_topic: str
    ears: Ears
    supervisor: Supervising
    still: Callable[[float], Any]  # a sample at a time [s], to rehearse with
    damping: float = 0.0  # [0..1] that goes with every command
    inputs: tuple[Input, ...] = ()


class ArmEars:
    """Ears for arms."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._reader = ArmReader(joints)

    @property
    def malformed(self) -> int:
        return self._reader.malformed

    def heard(self, joints: Joints) -> tuple[int, ArmSample] | None:
        row = self._reader.read(joints)
        if row is None:
            return None
        return row.stamp, ArmSample(
            row.time, row.q, row.q_velocity, row.theta, row.theta_velocity, row.spring_torque
        )  # fmt: skip


class JointEars:
    """Ears for joints."""

    def __init__(self, axes: JointAxes) -> None:
        self._reader = RowReader([(axes.device, ("q", *(f"theta_{i + 1}" for i in range(axes.n))))])

    @property
    def malformed(self) -> int:
        return self._reader.malformed[0]

    def heard(self, joints: Joints) -> tuple[int, JointSample] | None:
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows[0]
        return joints.stamp, JointSample(float(row[0]), float(row[1]), row[2:].copy())


def arm_equipment(name: str, joints: tuple[str, ...], supervisor: Supervisor) -> Equipment:
    """An arm, `joints` base first, under a supervisor of its own."""
    still = np.zeros(len(joints))

    def at(time: float) -> ArmSample:
        return ArmSample(time, still, still, still, still, still)

    return Equipment(name, command_topic(name), ArmEars(joints), supervisor, at)


def equipped(arm: VsaArm, law: ArmController[Any]) -> Equipment:
    """An arm and its law, with the usual limits and the usual way to hold it still."""
    return arm_equipment(arm.name, arm.joints, Supervisor(law, HoldStill(arm), ArmLimits(arm)))


def joint_equipment(
    axes: JointAxes,
    law: Controller[Any],
    begin: Callable[[], Any] | None = None,
    drive: float = 0.5,
    inputs: tuple[Input, ...] = (),
) -> Equipment:
    """A joint and its law likewise; `begin` and `drive` as in `JointSupervisor.of`."""
    device, still = axes.device, np.zeros(axes.n)

    def at(time: float) -> JointSample:
        return JointSample(time, 0.0, still)

    supervisor = JointSupervisor.of(law, axes, begin, drive)
    return Equipment(device.name, device.command_topic, JointEars(axes), supervisor, at, axes.damping, inputs)
