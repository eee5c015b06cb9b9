"""Samples of arms and joints from JointState messages."""

from __future__ import annotations

from math import nan
from typing import Any

from via_core.wire import link_name, motor_name, seconds
from via_ros.conversions import JointReader, Joints, RowReader, nanoseconds

from via_controllers.contract import ArmSample, JointSample
from via_controllers.robot import ControlledArm, ControlledJoint


class ArmSampleReader:
    """Finds the samples of an arm: one JointState with all links and motors."""

    def __init__(self, robot: ControlledArm) -> None:
        links, motors = [link_name(joint) for joint in robot.joints], [motor_name(joint, 1) for joint in robot.joints]
        entries = [(field, link) for field in ("position", "velocity") for link in links]
        entries += [(field, motor) for field in ("position", "velocity") for motor in motors]
        self._required = len(entries)
        entries += [("effort", link) for link in links]
        self._reader = JointReader([((*links, *motors), entries)])

    @property
    def malformed(self) -> int:
        """Number of arrays so far whose length differed from that of the names."""
        return self._reader.malformed[0]

    @property
    def origin(self) -> int | None:
        """[ns] stamp at which the time of samples is 0; None before the first one."""
        return self._reader.origins[0]

    def absent(self) -> str:
        """Joints that the last message about other joints lacks, '' without such a message."""
        return self._reader.absent()

    def missing(self) -> str:
        """Required values that the last sample lacks, '' if it has them."""
        return self._reader.missing(0, self._required)

    def read(self, joints: Joints) -> tuple[int, ArmSample] | None:
        """Stamp [ns] and sample of a message; None where the message is about other joints."""
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows
        return joints.stamp, ArmSample(float(row[0]), *row[1:].reshape(5, -1).copy())


class JointSampleReader:
    """Finds the samples of a joint, as `ArmSampleReader`."""

    def __init__(self, robot: ControlledJoint) -> None:
        axes = robot.axes
        self._reader = RowReader([(axes.device, ("q", *(f"theta_{i + 1}" for i in range(axes.n))))])

    @property
    def malformed(self) -> int:
        return self._reader.malformed[0]

    @property
    def origin(self) -> int | None:
        return self._reader.origins[0]

    def absent(self) -> str:
        return self._reader.absent()

    def missing(self) -> str:
        return self._reader.missing(0)

    def read(self, joints: Joints) -> tuple[int, JointSample] | None:
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows[0]
        return joints.stamp, JointSample(float(row[0]), float(row[1]), row[2:].copy())


def sample_reader(robot: ControlledArm | ControlledJoint) -> ArmSampleReader | JointSampleReader:
    """The reader for a robot's samples."""
    return ArmSampleReader(robot) if isinstance(robot, ControlledArm) else JointSampleReader(robot)


def time_since(origin: int | None, stamp: Any) -> float:
    """[s] from `origin` [ns] to a message's stamp; NaN without an origin."""
    return nan if origin is None else seconds(nanoseconds(stamp), origin)
