"""A reliable subscription that survives a message which the middleware cannot deliver.

A serialised message of zero bytes is such: Fast DDS 2.14 neither delivers it nor skips it, and a reliable reader receives
nothing more until the writer's history has been replaced, seconds later. When a stream falls silent, a second reader
without reliability listens too. If it hears what the first one does not, the first one is replaced.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from via_ros.spin import STEADY

LOOK = 0.1  # [s] between two checks
QUIET = 2  # checks without a message after which the second reader listens
HEARD = 2  # checks in which only the second reader heard something


class RenewedSubscription:
    """A raw subscription of `node`; `renewals` counts the replacements."""

    def __init__(
        self, node: Any, kind: Any, topic: str, callback: Callable[[bytes], None], profile: QoSProfile
    ) -> None:
        self._node, self._given = node, (kind, topic, callback, profile)
        self.renewals = 0
        self._heard = self._before = self._quiet = self._missed = 0
        self._second: Any = None
        self._first = node.create_subscription(kind, topic, self._take, profile, raw=True)
        self._timer = node.create_timer(LOOK, self._look, clock=STEADY)

    @property
    def topic_name(self) -> str:
        return str(self._first.topic_name)

    def get_publisher_count(self) -> int:
        """Number of connected publishers."""
        return int(self._first.get_publisher_count())

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._first)
        self._drop_second()

    def _take(self, data: bytes) -> None:
        self._heard += 1
        self._given[2](data)

    def _look(self) -> None:
        heard, self._before = self._heard - self._before, self._heard
        if heard or not self._heard:
            self._quiet = self._missed = 0
            self._drop_second()
            return
        self._quiet += 1
        kind, topic, _, profile = self._given
        if self._second is None and self._quiet >= QUIET and self._first.get_publisher_count():
            loose = QoSProfile(depth=profile.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._second = self._node.create_subscription(kind, topic, self._overhear, loose, raw=True)
        if self._missed >= HEARD:
            self._node.destroy_subscription(self._first)
            self._first = self._node.create_subscription(kind, topic, self._take, profile, raw=True)
            self.renewals += 1
            self._missed = 0
            self._drop_second()

    def _overhear(self, _: bytes) -> None:
        if self._second is not None:
            self._missed += 1

    def _drop_second(self) -> None:
        if self._second is not None:
            self._node.destroy_subscription(self._second)
            self._second = None
