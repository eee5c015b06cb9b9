"""Records topics into a bag without decoding them; counts received and missing messages.

ros2 run via_ros recorder --ros-args -p bag:=joint -p "topics:=['/joint_states', '/cubic_demo/stiffness']"

A topic with its type, '/joint_states:sensor_msgs/msg/JointState', is subscribed before it has a publisher, so that its
first message is recorded. Without `topics` all topics are recorded as they appear. A log line names each topic at its
first message. Only a properly closed bag gets its final name; otherwise the file keeps its unfinished name.

Messages are handed to the operating system every 50 ms, so that a killed recorder loses at most those of the last
100 ms. After `max_bag_duration` the bag gets another file, since the index of a file stays in memory until its end. The
log time is that of this machine, even if the node uses simulated time; jumps of simulated time make the bag incomplete.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from via_core.bags.writer import JUMPS, BagWriter
from via_core.errors import BagError, ParameterError
from via_core.parameters import parameter

from via_ros import qos
from via_ros.interfaces import ENCAPSULATION, NUMBERED, message_class, opening_of
from via_ros.parameters import declare
from via_ros.reports import pairs, report, status_name
from via_ros.spin import STEADY, run

POLL = 0.1  # [s] interval of discovery
FLUSH = 0.05  # [s] between two chunks at most
JUMP = Duration(seconds=1)  # of simulated time, forward; backward any
REPORT = 1.0  # [s] interval of diagnostics
HINT = 3.0  # [s] after which wanted topics without a publisher are named


@dataclass(frozen=True)
class Parameters:
    bag: str = parameter("", "folder of the new bag; must not exist")
    topics: tuple[str, ...] = parameter((), "topics to record, 'name' or 'name:type'; empty: all")
    max_bag_duration: float = parameter(60.0, "duration after which the bag gets another file", "s", (1.0, 1e9))


@dataclass
class Count:
    """Counts of one topic."""

    type_name: str
    messages: int = 0
    size: int = 0  # [bytes]
    lost: int = 0  # missing sequence numbers of a numbered type with one publisher
    last: int = -1  # sequence number of the last message
    before: int = 0  # sequence number of the first message: so many were sent before it
    malformed: int = 0  # discarded: shorter than its header, or than its sequence number for a numbered type


class Recorder(Node):
    """Recorder node; result of `finished`: 2, with a line on stderr, when the bag cannot be written."""

    def __init__(self, **node_options: object) -> None:
        super().__init__("recorder", **node_options)
        self.parameters = declare(self, Parameters)
        if not self.parameters.bag:
            raise ParameterError("parameter bag must name the folder to record into, got ''")
        self.counts: dict[str, Count] = {}
        self.finished = Future()
        self._unknown: set[str] = set()
        self._refused: set[str] = set()  # topics with a publisher whose QoS does not match the subscription
        self._subscriptions_of: dict[str, Subscription] = {}
        wanted = [text.partition(":") for text in self.parameters.topics]
        self._wanted = {self.resolve_topic_name(name): type_name for name, _, type_name in wanted}
        for type_name in filter(None, self._wanted.values()):
            message_class(type_name)  # raises for a wrong type, before the bag is created
        self._writer = BagWriter(self.parameters.bag, max_duration=self.parameters.max_bag_duration)
        self._epoch = time.time_ns() - time.monotonic_ns()  # [ns] a bag's time neither jumps nor runs backward
        self._jumps = 0
        self._jump = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=JUMP, min_backward=Duration(nanoseconds=-1), on_clock_change=False),
            post_callback=self._jumped,
        )
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        for name, type_name in self._wanted.items():
            if type_name:
                self._hear(name, type_name)
        self._look()
        self.create_timer(POLL, self._look, clock=STEADY)
        self.create_timer(REPORT, self._report, clock=STEADY)
        self.create_timer(FLUSH, self._flush, clock=STEADY)
        self._hint, self._hinted = self.create_timer(HINT, self._name_missing, clock=STEADY), ""
        what = ", ".join(self._wanted) or "all topics"
        self.get_logger().info(f"records {what} into {self.parameters.bag} as messages arrive; Ctrl-C ends the bag")

    def _look(self) -> None:
        while self._refused:
            name = self._refused.pop()
            self.destroy_subscription(self._subscriptions_of[name])
            self._subscribe(name)
        if self._wanted and self.counts.keys() >= self._wanted.keys():
            return
        for name, type_names in self.get_topic_names_and_types():
            if name in self.counts or name in self._unknown or (self._wanted and name not in self._wanted):
                continue
            if not self._wanted and not self.get_publishers_info_by_topic(name):
                continue  # no publisher yet: the offered QoS is unknown
            try:
                if len(type_names) != 1:
                    raise BagError(f"it has several types: {', '.join(type_names)}")
                self._hear(name, type_names[0])
            except BagError as error:
                self._unknown.add(name)
                self.get_logger().warning(f"{name} is not recorded: {error}")

    def _name_missing(self) -> None:
        """Log the wanted topics without a publisher, beside those that exist; again when these change."""
        missing = sorted(name for name in self._wanted if not self.get_publishers_info_by_topic(name))
        if not missing:
            self._hint.cancel()
            return
        there = [name for name, _ in self.get_topic_names_and_types() if self.get_publishers_info_by_topic(name)]
        hint = f"nobody publishes {', '.join(missing)} yet; published are: {', '.join(sorted(there))}"
        if hint != self._hinted:  # on a busy machine other nodes are found later than this one looks
            self.get_logger().warning(hint)
            self._hinted = hint

    def _hear(self, name: str, type_name: str) -> None:
        message_class(type_name)  # raises for a type that is not installed
        self.counts[name] = Count(type_name)
        self._subscribe(name)

    def _subscribe(self, name: str) -> None:
        """Subscribe with a QoS that matches all present publishers."""
        count = self.counts[name]
        offers = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
        self._subscriptions_of[name] = self.create_subscription(
            message_class(count.type_name),
            name,
            partial(self._take, name, count, opening_of if count.type_name in NUMBERED else None),
            qos.matching(offers),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=lambda _: self._refused.add(name)),
            raw=True,
        )

    def _take(self, name: str, count: Count, opening: Callable | None, data: bytes) -> None:
        opened = None if opening is None else opening(data)
        if self.finished.done():
            return
        try:
            if count.messages == 0:
                offers = [qos.as_offered(info.qos_profile) for info in self.get_publishers_info_by_topic(name)]
                self._writer.add_topic(name, count.type_name, tuple(offers) or (qos.as_offered(qos.SAMPLES),))
            if len(data) < ENCAPSULATION or (opening is not None and opened is None):
                count.malformed += 1
                return
            self._writer.write(name, data, self._epoch + time.monotonic_ns(), sequence=count.messages)
        except BagError as error:
            self._end(error)
            return
        if count.messages == 0:
            self.get_logger().info(f"recording {name}")
        count.messages += 1
        count.size += len(data)
        if opened is not None:
            # A restarted publisher counts from 0: no loss is known.
            _, number = opened
            if count.messages == 1:
                count.before = number
            else:
                count.lost += max(number - count.last - 1, 0)
            count.last = number

    def _flush(self) -> None:
        if not self.finished.done():
            try:
                self._writer.flush()
            except BagError as error:
                self._end(error)

    def _end(self, error: BagError) -> None:
        """End the node; an exception would make the executor print a traceback."""
        print(f"{self.get_name()}: {error}", file=sys.stderr)
        self.finished.set_result(2)

    def _jumped(self, _: object) -> None:
        self._jumps += 1
        self._writer.metadata[JUMPS] = str(self._jumps)
        self.get_logger().warning(f"simulated time has jumped {self._jumps} times")

    def _report(self) -> None:
        statuses = []
        for name in self._wanted.keys() | self.counts.keys():
            count = self.counts.get(name)
            level, text = DiagnosticStatus.OK, "recording"
            if count is None or count.messages == 0:
                level, text = DiagnosticStatus.WARN, "no message yet"
            elif count.lost:
                level, text = DiagnosticStatus.ERROR, "messages are missing"
            elif count.malformed:
                level, text = DiagnosticStatus.WARN, "malformed messages are left out"
            elif count.before:
                level, text = DiagnosticStatus.WARN, "messages were sent before the first recorded one"
            status = DiagnosticStatus(level=level, name=status_name(self, name), message=text)
            if count is not None:
                shown = {"messages": count.messages, "lost": count.lost, "malformed": count.malformed}
                shown |= {"sent before the first": count.before, "bytes": count.size}
                status.values = pairs(shown)
            statuses.append(status)
        report(self, self._reports, statuses)

    def close(self, failed: bool = False) -> None:
        """Close the bag under its final name; after a failure leave it under its unfinished name."""
        if failed:
            self._writer.abandon()
            return
        self._drain()
        self._writer.close()
        total = sum(count.messages for count in self.counts.values())
        lost = sum(count.lost for count in self.counts.values())
        empty = sorted(name for name in self._wanted.keys() | self.counts.keys() if not self._received(name))
        topics = len(self.counts.keys() - set(empty))
        text = f"{self.parameters.bag}: {total} messages on {topics} topics, {lost} missing"
        late = [f"{each.before} on {name}" for name, each in sorted(self.counts.items()) if each.before]
        text += f"; sent before the first recorded one: {', '.join(late)}" if late else ""
        # Not the logger: the context may be gone.
        print(text + (f"; no message on {', '.join(empty)}" if empty else ""), file=sys.stderr)

    def _drain(self) -> None:
        """Record what has arrived and waits in the queues, at most as much as one queue holds of each topic."""
        for subscription in self._subscriptions_of.values():
            for _ in range(qos.SAMPLES.depth):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                subscription.callback(taken[0])

    def _received(self, name: str) -> bool:
        return name in self.counts and self.counts[name].messages > 0


def main() -> int:
    return run(Recorder)
