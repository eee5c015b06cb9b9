"""Data that `via watch` shows of the joints on the graph: the newest message of each topic, and counts of samples.

No executor runs: a callback costs a tenth of a millisecond, too much for 16 joints at 1 kHz. `look` takes the messages
that have arrived since the last one instead; of estimates the middleware keeps the newest only.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from via_core.wire import SECOND
from via_interfaces.msg import DampingEstimate, GapStatus, StiffnessEstimate
from via_ros.serialised import JointStateDecoder

LINK, MOTOR = "_shaft_joint", "_motor_"
KINDS = {kind.__name__: kind for kind in (StiffnessEstimate, DampingEstimate, GapStatus)}
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # suits every publisher
EVERY = QoSProfile(depth=20_000, reliability=ReliabilityPolicy.BEST_EFFORT)
SPAN = 2 * SECOND  # [ns] of stamps over which rates are averaged
GAP = 1.5  # intervals between samples above which samples are missing
FORGET = 5.0  # [s] without a message after which a warning is dropped


@dataclass
class Samples:
    """Stamps of the samples of a joint."""

    stamps: list[int] = field(default_factory=list)  # [ns] of the last SPAN
    gaps: int = 0  # intervals above GAP times the median since the start
    last: float = 0.0  # [s] steady clock at the last sample

    def take(self, stamps: list[int], now: float) -> None:
        """Append new stamps; a clock that ran back starts anew."""
        if not stamps:
            return
        before = self.stamps if not self.stamps or stamps[0] > self.stamps[-1] else []
        joined = [*before, *stamps]
        steps = np.diff(joined)
        fresh = steps[max(len(before) - 1, 0) :]
        self.gaps += int(np.sum(fresh > GAP * np.median(steps))) if len(steps) > 2 else 0
        self.stamps = [each for each in joined if joined[-1] - each <= SPAN]
        self.last = now

    @property
    def rate(self) -> float:
        """Samples per second [Hz] by their stamps; NaN for fewer than two."""
        if len(self.stamps) < 2:
            return float("nan")
        return (len(self.stamps) - 1) * SECOND / (self.stamps[-1] - self.stamps[0])


@dataclass
class Watched:
    """The joints of the graph; `node` needs no executor."""

    node: Any
    joint_topic: str = "/joint_states"
    samples: dict[str, Samples] = field(default_factory=dict)  # by joint
    newest: dict[str, Any] = field(default_factory=dict)  # message by topic
    _warnings: dict[str, tuple[float, DiagnosticStatus]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._decoder = JointStateDecoder()
        self._reports = self._subscribe(DiagnosticArray, "/diagnostics", QoSProfile(depth=1000))
        self._joint_states = self._subscribe(JointState, self.joint_topic, EVERY)
        self._subscriptions: dict[str, Any] = {}

    def _subscribe(self, kind: Any, topic: str, profile: QoSProfile) -> Any:
        return self.node.create_subscription(kind, topic, lambda _: None, profile, raw=kind is JointState)

    def look(self) -> None:
        """Take what has arrived since the last call."""
        now = time.monotonic()
        for topic, types in self.node.get_topic_names_and_types():
            kind = KINDS.get(types[0].rsplit("/", 1)[-1])
            if kind is not None and "/truth/" not in topic and topic not in self._subscriptions:
                self._subscriptions[topic] = self._subscribe(kind, topic, NEWEST)
        for topic, subscription in self._subscriptions.items():
            for message in _taken(subscription):
                self.newest[topic] = message
        stamps: dict[str, list[int]] = {}
        for data in _taken(self._joint_states):
            joints = self._decoder.decode(data)
            for name in joints.names.joints if joints is not None else ():
                if MOTOR not in name:
                    stamps.setdefault(name.removesuffix(LINK), []).append(joints.stamp)  # type: ignore[union-attr]
        for name, each in stamps.items():
            self.samples.setdefault(name, Samples()).take(each, now)
        for report in _taken(self._reports):
            for status in report.status:
                self._warnings[status.name] = (now, status)

    def joints(self) -> list[str]:
        """Joints with samples, an estimate or a gap, in alphabetical order."""
        return sorted({*self.samples, *(each.header.frame_id for each in self.newest.values())})

    def estimates(self, joint: str) -> dict[str, dict[str, Any]]:
        """Newest estimates of a joint by method, and 'stiffness' or 'damping'."""
        found: dict[str, dict[str, Any]] = {}
        for topic, message in self.newest.items():
            if message.header.frame_id == joint and not isinstance(message, GapStatus):
                found.setdefault(message.method, {})[topic.rsplit("/", 1)[-1]] = message
        return found

    def gap(self, joint: str) -> GapStatus | None:
        """Newest state of the gap monitor of a joint."""
        found = [each for each in self.newest.values() if isinstance(each, GapStatus)]
        return next((each for each in found if each.header.frame_id == joint), None)

    def warnings(self) -> list[DiagnosticStatus]:
        """Diagnostics that are not OK, the most severe first."""
        now = time.monotonic()
        found = [each for seen, each in self._warnings.values() if now - seen < FORGET and each.level != b"\x00"]
        return sorted(found, key=lambda each: (-each.level[0], each.name))


def _taken(subscription: Any) -> list[Any]:
    """Messages, or their bytes, that have arrived at a subscription without an executor."""
    found = []
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            found.append(taken[0])
    return found
