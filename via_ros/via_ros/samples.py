"""The samples that a node takes from JointState messages, and what its diagnostics report of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from via_ros.conversions import JointReader, Joints
from via_ros.gate import LOSSY, RenewedSubscription
from via_ros.serialised import JointStateDecoder


class SampleStream:
    """Decodes the messages of a topic and copies their numbers into the rows of `reader`.

    take    called with the contents of each message and the indices of the rows that it updated
    broken  number of messages that could not be decoded
    """

    def __init__(
        self, node: Any, topic: str, reader: JointReader, take: Callable[[Joints, list[int]], None], profile: QoSProfile
    ) -> None:
        self.reader, self.broken = reader, 0
        self._take, self._decoder = take, JointStateDecoder()
        self.subscription = RenewedSubscription(node, JointState, topic, self._receive, profile)

    def destroy(self) -> None:
        """Destroy the subscription."""
        self.subscription.destroy()

    @property
    def is_lossy(self) -> bool:
        """Whether samples are published best effort."""
        return self.subscription.is_lossy

    def malformed(self, row: int = 0) -> int:
        """Number of malformed messages, as far as they concern a row."""
        return self.broken + self.reader.malformed[row]

    def conditions(
        self, silent: bool, row: int = 0, required: int | None = None, unusable: bool = True
    ) -> dict[str, bool]:
        """What may be wrong with the samples of a row, and whether it is.

        silent    no sample came since the last report
        required  so many first values of the row must be there; None: all
        unusable  the last sample could not be used, so that missing values are reported
        """
        absent, missing = self.reader.absent(), self.reader.missing(row, required)
        return {
            "no samples": silent,
            LOSSY: self.is_lossy,
            absent: silent and bool(absent),
            f"no value of {missing}": unusable and bool(missing),
        }

    def _receive(self, data: bytes) -> None:
        joints = self._decoder.decode(data)
        if joints is None:
            self.broken += 1
        else:
            self._take(joints, self.reader.read(joints))
