"""Gate of a node: a bad message or request is refused, counted and reported, and never ends the node.

A callback behind the gate may raise for a message that it cannot use: a status that does not exist, a duration that
overflows, a reference out of reach. Messages that are never decoded because of their size: see `serialised`.

RenewedSubscription takes samples whatever the quality of service (QoS) of their publishers: many drivers publish with
the best-effort profile of sensors, which a reliable reader does not receive. It becomes the strictest reader that all
publishers suit, and `is_lossy` shows it.

It also survives a message that the middleware cannot deliver. A serialised message of zero bytes is such:
Fast DDS 2.14 neither delivers it nor skips it, and a reliable reader receives nothing more until the writer's history
has been replaced, seconds later. When a stream falls silent, a second reader without reliability listens too. If it
hears what the first one does not, the first one is replaced.

SampleStream takes the samples of joints through one, and names what is wrong with them in diagnostics.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from math import inf, nan
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from via_core.errors import ViaError
from via_core.text_files import shown
from via_core.wire import seconds

from via_ros import qos
from via_ros.conversions import JointReader, Joints, nanoseconds
from via_ros.serialised import JointStateDecoder
from via_ros.spin import STEADY

# What the content of a message can cause; any other exception is a fault of the program.
BAD = (ViaError, ValueError, ArithmeticError, struct.error)
LOGGED = 1.0  # [s] between two reasons in the log
LOOK = 0.1  # [s] between two checks of a subscription
LOSSY = "messages are published best effort, so that some can be lost: publish reliably"
QUIET = 2  # checks without a message after which the second reader listens
HEARD = 2  # checks in which only the second reader heard something


class Gate:
    """Counts what the callbacks of a node refuse; new reasons are logged, one per LOGGED at most.

    A reason may contain the refused number, which can change with every message.
    """

    def __init__(self, logger: Any) -> None:
        self.refused = 0
        self.reason = ""  # of the last refusal
        self._logger = logger
        self._logged = -inf  # [s] steady clock

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
        now = time.monotonic()
        if reason != self.reason and now - self._logged >= LOGGED:
            self._logged = now
            self._logger.warning(f"refused: {reason}")
        self.reason = reason


class RenewedSubscription:
    """A raw subscription of `node`; `renewals` counts the replacements, `is_lossy`: publishers do not send again."""

    def __init__(
        self, node: Any, kind: Any, topic: str, callback: Callable[[bytes], None], profile: QoSProfile
    ) -> None:
        self._node, self._given = node, (kind, topic, callback, profile)
        self.renewals = 0
        self._heard = self._before = self._quiet = self._missed = 0
        self._second: Any = None
        self._destroyed = self._refused = self.is_lossy = False
        self._first = self._subscription(profile)
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
        if self._refused:
            self._suit_publishers()
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
            self._replace(profile)
            self._missed = 0
            self._drop_second()

    def _subscription(self, profile: QoSProfile) -> Any:
        def refuse(_: Any) -> None:
            self._refused = True

        kind, topic, _, _ = self._given
        events = SubscriptionEventCallbacks(incompatible_qos=refuse)
        return self._node.create_subscription(kind, topic, self._take, profile, event_callbacks=events, raw=True)

    def _replace(self, profile: QoSProfile) -> None:
        self._node.destroy_subscription(self._first)
        self._first = self._subscription(profile)
        self.renewals += 1

    def _suit_publishers(self) -> None:
        """Subscribe with the strictest QoS that all publishers offer."""
        kind, topic, callback, profile = self._given
        offers = self._node.get_publishers_info_by_topic(topic)
        suited = qos.matching([each.qos_profile for each in offers], profile.depth)
        if suited.reliability == profile.reliability:  # the graph does not show that publisher yet, or any more
            return
        self._refused, self.is_lossy = False, True
        self._given = kind, topic, callback, suited
        self._replace(suited)
        self._node.get_logger().warning(f"{self.topic_name}: {LOSSY}")

    def _overhear(self, _: bytes) -> None:
        if self._second is not None:
            self._missed += 1

    def _drop_second(self) -> None:
        if self._second is not None:
            self._node.destroy_subscription(self._second)
            self._second = None


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

    def time_of(self, stamp: Any, row: int = 0) -> float:
        """[s] of a message's stamp in the time of a row; NaN before its first sample."""
        origin = self.reader.origins[row]
        return nan if origin is None else seconds(nanoseconds(stamp), origin)

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
