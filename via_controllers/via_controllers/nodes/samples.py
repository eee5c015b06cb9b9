"""Samples of a robot from JointState messages."""

from __future__ import annotations

from math import nan
from typing import Any

from via_core.wire import seconds
from via_ros.conversions import JointReader, Joints, nanoseconds

from via_controllers.robot import Controlled


class SampleReader:
    """Finds the samples of an arm or a joint: one JointState with all that `robot.reading` lists."""

    def __init__(self, robot: Controlled) -> None:
        joints, entries, self._required = robot.reading
        self._reader = JointReader([(joints, entries)])
        self._sample = robot.sample

    @property
    def malformed(self) -> int:
        """Number of arrays so far whose length differed from that of the names."""
        return self._reader.malformed[0]

    def time_of(self, stamp: Any) -> float:
        """[s] of a message's stamp in the time of samples; NaN before the first sample."""
        (origin,) = self._reader.origins
        return nan if origin is None else seconds(nanoseconds(stamp), origin)

    def absent(self) -> str:
        """Joints that the last message about other joints lacks, '' without such a message."""
        return self._reader.absent()

    def missing(self) -> str:
        """Required values that the last sample lacks, '' if it has them."""
        return self._reader.missing(0, self._required)

    def read(self, joints: Joints) -> tuple[int, Any] | None:
        """Stamp [ns] and sample of a message; None where the message is about other joints."""
        if not self._reader.read(joints):
            return None
        (row,) = self._reader.rows
        return joints.stamp, self._sample(row)
