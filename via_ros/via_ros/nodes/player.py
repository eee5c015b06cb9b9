"""Plays a bag to live nodes in stamp order, reproducibly, with /clock before every new stamp; a recorded /clock is not.

ros2 run via_ros player --ros-args -p bag:=joint -p rate:=0.0 -p subscribers:=1 -p "answers:=['/cubic_demo/stiffness']"

rate N plays N times as fast as recorded, 0 as fast as the subscribers process. Delivery by the middleware does not mean
that a message was processed. Therefore `answers` lists the topics on which subscribers answer samples, each answer with
the stamp of its sample, and the player stays at most `window` JointState messages ahead of the slowest. Without answers
it publishes OPEN_LOOP_RATE messages per second at rate 0.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from via_core.bags.reader import RawMessage, read_bag
from via_core.errors import BagError, ParameterError
from via_core.parameters import parameter
from via_core.wire import JOINT_STATE, SECOND

from via_ros import qos
from via_ros.conversions import set_stamp
from via_ros.interfaces import message_class, stamp_of
from via_ros.parameters import declare
from via_ros.spin import FOREVER, STEADY, run

CLOCK = "/clock"
POLL = 0.02  # [s] interval of discovery
OPEN_LOOP_RATE = 2000  # [1/s] messages at rate 0 without answers: a quarter of what a Python node can process
END_OF_TIME = 2**31 * SECOND  # [ns] seconds of a ROS stamp have 32 bits
SLOWEST = 1e-3  # [-] smallest rate above 0
SETTLE = 0.1  # [s] for discovery of this player by the subscribers


@dataclass(frozen=True)
class Parameters:
    bag: str = parameter("", "bag to play: folder or .mcap file")
    topics: tuple[str, ...] = parameter((), "topics to play; empty: all of the bag")
    rate: float = parameter(1.0, "playback speed; 0: as fast as the subscribers process", "-", (0.0, 1e4))
    subscribers: int = parameter(1, "subscribers that every sample topic needs before playback starts", limits=(0, 100))
    answers: tuple[str, ...] = parameter((), "topics on which subscribers answer each sample with its stamp")
    window: int = parameter(200, "largest number of unanswered samples at rate 0", limits=(1, qos.SAMPLES.depth))
    patience: float = parameter(20.0, "longest wait for a subscriber or an answer", "s", (0.1, 3600.0))


class Player(Node):
    """Plays in its own thread; `finished` gives 0, or 3 with a line on stderr when a subscriber stops answering."""

    def __init__(self, **node_options: object) -> None:
        super().__init__("player", **node_options)
        self.parameters = p = declare(self, Parameters)
        if not p.bag:
            raise ParameterError("parameter bag must name the bag to play, got ''")
        if 0.0 < p.rate < SLOWEST:
            raise ParameterError(f"parameter rate must be 0 or at least {SLOWEST:g}, got {p.rate!r}")
        bag = read_bag(p.bag, p.topics or None)
        for remark in bag.remarks:
            self.get_logger().warning(f"{p.bag}: {remark}")
        missing = [name for name in p.topics if name not in bag]
        topics = {name: topic for name, topic in bag.topics.items() if name != CLOCK}
        self._messages = list(bag.in_stamp_order(topics))
        if missing or not self._messages:
            raise BagError(f"{p.bag} has no messages on {', '.join(missing or p.topics) or 'any topic'}")
        self.played = 0
        self.finished = Future()
        last = self._messages[-1].stamp
        if last >= END_OF_TIME:
            raise BagError(f"{p.bag}: the stamp {last} ns exceeds the range of /clock; `via bag info` shows the topic")
        self._topics = {
            name: self.create_publisher(message_class(topic.type_name), name, qos.from_bag(topic.qos))
            for name, topic in topics.items()
        }
        samples = [name for name, topic in topics.items() if topic.type_name == JOINT_STATE]
        self._awaited = [self._topics[name] for name in samples or self._topics]
        self._now = self.create_publisher(Clock, CLOCK, qos.CONTROL)
        self._answered = dict.fromkeys(p.answers, -1)  # [ns] stamp of the last answer
        self._answer_types: dict[str, Any] = {}
        self._change = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self.create_timer(POLL, self._look, clock=STEADY)
        self._thread.start()

    # --- in the executor ---

    def _look(self) -> None:
        """Subscribe to answers as soon as discovery has their type."""
        for name in self._answered.keys() - self._answer_types.keys():
            for info in self.get_publishers_info_by_topic(name):
                kind = self._answer_types[name] = message_class(info.topic_type)
                self.create_subscription(kind, name, partial(self._hear, name), qos.SAMPLES, raw=True)
                break
        with self._change:
            self._change.notify_all()

    def _hear(self, name: str, data: bytes) -> None:
        stamp = stamp_of(data)
        if stamp is not None:
            with self._change:
                self._answered[name] = max(self._answered[name], stamp)
                self._change.notify_all()

    # --- in the thread that plays ---

    def _play(self) -> None:
        try:
            self._wait(self._subscribers_are_ready, self._who_is_missing)
            self._sleep_until(time.monotonic_ns() + round(SETTLE * SECOND))
            self._publish_all()
            if not self._answered:
                self._until_acknowledged()
            span = (self._messages[-1].stamp - self._messages[0].stamp) / SECOND
            print(f"{self.parameters.bag}: {self.played} messages over {span:.3f} s played", file=sys.stderr)
            self.finished.set_result(0)
        except BagError as error:
            if not self._stopped:
                print(f"{self.get_name()}: {error}", file=sys.stderr)
                self.finished.set_result(3)

    def _publish_all(self) -> None:
        p = self.parameters
        first, start = self._messages[0].stamp, time.monotonic_ns()
        clock, unanswered, now = Clock(), deque[int](), None
        for message in self._messages:
            if p.rate > 0.0:
                self._sleep_until(start + round((message.stamp - first) / p.rate))
            elif self._answered and message.type_name == JOINT_STATE:
                self._keep_back(unanswered, message)
            elif not self._answered:
                self._sleep_until(start + self.played * SECOND // OPEN_LOOP_RATE)
            if self._stopped:
                raise BagError("stopped")
            if message.stamp != now and message.stamp >= 0:  # /clock cannot be negative
                now = message.stamp
                set_stamp(clock.clock, now)
                self._now.publish(clock)
            self._topics[message.topic].publish(message.data)
            self.played += 1
        if p.rate == 0.0 and unanswered:
            last = unanswered[-1]
            self._wait(lambda: self._slowest() >= last, lambda: f"no answer to the last sample on {self._silent()}")

    def _keep_back(self, unanswered: deque[int], message: RawMessage) -> None:
        """Wait until fewer than `window` samples are unanswered."""
        unanswered.append(message.stamp)
        if len(unanswered) > self.parameters.window:
            oldest = unanswered[0]
            self._wait(lambda: self._slowest() >= oldest, lambda: f"no answer on {self._silent()}")
            while unanswered and unanswered[0] <= self._slowest():
                unanswered.popleft()

    def _slowest(self) -> int:
        return min(self._answered.values())

    def _silent(self) -> str:
        return min(self._answered, key=lambda name: self._answered[name])

    def _subscribers_are_ready(self) -> bool:
        heard = all(each.get_subscription_count() >= self.parameters.subscribers for each in self._awaited)
        return heard and self._answer_types.keys() == self._answered.keys()

    def _who_is_missing(self) -> str:
        silent = self._answered.keys() - self._answer_types.keys()
        if silent:
            return f"no publisher of answers on {', '.join(sorted(silent))}"
        counts = ", ".join(f"{each.topic_name} {each.get_subscription_count()}" for each in self._awaited)
        return f"waited for {self.parameters.subscribers} subscribers per topic, there are: {counts}"

    def _wait(self, condition: Callable[[], bool], complaint: Callable[[], str]) -> None:
        """Wait until condition(). Raises BagError after `patience` seconds."""
        with self._change:
            if not self._change.wait_for(lambda: self._stopped or condition(), timeout=self.parameters.patience):
                raise BagError(f"{complaint()} for {self.parameters.patience:g} s; {self.played} messages played")
        if self._stopped:
            raise BagError("stopped")

    def _sleep_until(self, due: int) -> None:
        """Sleep until the steady clock reaches `due` [ns] or the node is closed."""
        with self._change:
            while not self._stopped and (left := due - time.monotonic_ns()) > 0:
                self._change.wait(min(left / SECOND, FOREVER))

    def _until_acknowledged(self) -> None:
        """Wait for acknowledgement: messages not acknowledged are lost with their publisher."""
        limit = Duration(nanoseconds=round(self.parameters.patience * SECOND))
        for name, publisher in self._topics.items():
            if not publisher.wait_for_all_acked(limit):
                raise BagError(f"{name} was not acknowledged for {self.parameters.patience:g} s")

    def close(self, failed: bool = False) -> None:
        """Stop publishing and join the thread."""
        with self._change:
            self._stopped = True
            self._change.notify_all()
        self._thread.join()


def main() -> int:
    return run(Player)
