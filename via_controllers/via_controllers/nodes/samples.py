"""Samples of arms and joints from JointState messages."""

from __future__ import annotations

from typing import Any, Protocol

from via_ros.arms import ArmReader
from via_ros.conversions import Joints, RowReader

from via_controllers.contract import ArmSample, JointSample
from via_controllers.joint_axes import JointAxes
from via_controllers.robot import ControlledArm, ControlledJoint


class SampleReader(Protocol):
    """Finds the samples of one robot."""

    @property
    def malformed(self) -> int:
        """Number of arrays so far whose length differed from that of the names."""

    def read(self, joints: Joints) -> tuple[int, Any] | None:
        """Stamp [ns] and sample of a message; None where the message is about other joints."""


class ArmSampleReader:
    """SampleReader of an arm; `joints` are named base first."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._reader = ArmReader(joints)

    @property
    def malformed(self) -> int:
        return self._reader.malformed

    def read(self, joints: Joints) -> tuple[int, ArmSample] | None:
        row = self._reader.read(joints)
        if row is None:
            return None
        return row.stamp, ArmSample(
            row.time, row.q, row.q_velocity, row.theta, row.theta_velocity, row.spring_torque
        )  # fmt: skip


class JointSampleReader:
    """SampleReader of a joint."""

    def __init__(self, axes: JointAxes) -> None:
        self._reader = RowReader([(axes.device, ("q", *(f"theta_{i + 1}" for i in range(axes.n))))])

    @property
    def malformed(self) -> int:
        return self._reader.malformed[0]

    def read(self, joints: Joints) -> tuple[int, JointSample] | None:
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows[0]
        return joints.stamp, JointSample(float(row[0]), float(row[1]), row[2:].copy())


def sample_reader(robot: ControlledArm | ControlledJoint) -> SampleReader:
    """The reader for a robot's samples."""
    return ArmSampleReader(robot.joints) if isinstance(robot, ControlledArm) else JointSampleReader(robot.axes)
