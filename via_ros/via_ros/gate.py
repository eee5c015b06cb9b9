"""Gate of a node: a bad message or request is refused, counted and reported, and never ends the node.

A callback behind the gate may raise for a message that it cannot use: a status that does not exist, a duration that
overflows, a reference out of reach. Messages that are never decoded because of their size: see `serialised`.

RenewedSubscription survives a message that the middleware cannot deliver. A serialised message of zero bytes is such:
Fast DDS 2.14 neither delivers it nor skips it, and a reliable reader receives nothing more until the writer's history
has been replaced, seconds later. When a stream falls silent, a second reader without reliability listens too. If it
hears what the first one does not, the first one is replaced.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from via_core.errors import ViaError
from via_core.text_files import shown

from via_ros.spin import STEADY

# What the content of a message can cause; any other exception is a fault of the program.
BAD = (ViaError, ValueError, ArithmeticError, struct.error)
LOOK = 0.1  # [s] between two checks of a subscription
QUIET = 2  # checks without a message after which the second reader listens
HEARD = 2  # checks in which only the second reader heard something


class Gate:
    """Counts what the callbacks of a node refuse; the reason of each first refusal in a row is logged."""

    def __init__(self, logger: Any) -> None:
        self.refused = 0
        self.reason = ""  # of the last refusal
        self._logger = logger

    def message(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """The callback of a subscription."""

        def admitted(message: Any) -> None:
            try:
                callback(message)
            except BAD as error:
                self._refuse(error)

        return admitted

    def request(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """The callback of a service whose response has `success` and `message`."""

        def admitted(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except BAD as error:
                self._refuse(error)
                response.success, response.message = False, self.reason
                return response

        return admitted

    def _refuse(self, error: Exception) -> None:
        self.refused += 1
        reason = shown(" ".join(str(error).split())[:200]) or type(error).__name__
        if reason != self.reason:
            self._logger.warning(f"refused: {reason}")
        self.reason = reason


class RenewedSubscription:
    """A raw subscription of `node`; `renewals` counts the replacements."""

    def __init__(
        self, node: Any, kind: Any, topic: str, callback: Callable[[bytes], None], profile: QoSProfile
    ) -> None:
        self._node, self._given = node, (kind, topic, callback, profile)
        self.renewals = 0
        self._heard = self._before = self._quiet = self._missed = 0
        self._second: Any = None
        self._destroyed = False
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
        self._destroyed = True
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._first)
        self._drop_second()

    def _take(self, data: bytes) -> None:
        self._heard += 1
        self._given[2](data)

    def _look(self) -> None:
        if self._destroyed:  # by a callback that ran after this timer had been found ready
            return
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
