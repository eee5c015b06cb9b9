"""Who else drives or commands a device, from the graph.

A driver, real or simulated, publishes samples of the device and subscribes to its commands. A commander publishes
commands. With two of either, samples or torques of different origin alternate; the torques then fit neither.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from sensor_msgs.msg import JointState

from via_ros import qos
from via_ros.interfaces import opening_of
from via_ros.serialised import JointStateDecoder

MOST = 8  # names in a text
RECENT = 1.0  # [s] for which an observation counts
PATIENCE = 0.5  # [s] of listening before nothing counts as silence
KEPT = 1000  # own stamps that are remembered


def commanders(node: Any, command_topic: str) -> list[str]:
    """Names of the nodes that publish commands, one per publisher."""
    return _names(node.get_publishers_info_by_topic(command_topic))


def drivers(node: Any, joint_topic: str, command_topic: str) -> list[str]:
    """Names of the nodes that publish samples and subscribe to the commands, one per subscription."""
    talking = set(_names(node.get_publishers_info_by_topic(joint_topic)))
    return [name for name in _names(node.get_subscriptions_info_by_topic(command_topic)) if name in talking]


def rivalry(node: Any, joint_topic: str, command_topic: str) -> tuple[dict[str, bool], dict[str, str]]:
    """Warnings about several commanders or drivers of the joints, and the names of all, for diagnostics."""
    found = {"commanders": commanders(node, command_topic), "drivers": drivers(node, joint_topic, command_topic)}
    warnings = {f"{len(names)} {what}: {', '.join(names[:MOST])}": len(names) > 1 for what, names in found.items()}
    return warnings, {what: ", ".join(names) for what, names in found.items()}


class CommandOrigin:
    """Whether commands of several publishers alternate: their sequence numbers then run backward again and again.

    The graph alone is no evidence: it contains a killed node for some 20 s. A restarted node counts from 0 once.
    """

    def __init__(self) -> None:
        self._last = -1
        self._backward = deque([float("-inf")] * 2, maxlen=2)  # [s] steady clock

    def is_mixed(self, data: bytes) -> bool:
        """Whether this command, and another one within RECENT, has a number that its predecessor excludes."""
        opened, now = opening_of(data), time.monotonic()
        if opened is not None:
            if opened[1] <= self._last:
                self._backward.append(now)
            self._last = opened[1]
        return now - self._backward[0] <= RECENT


class DriverOrigin:
    """Whether another node publishes samples of the joints of `node`; it listens only if the graph has another driver.

    joint_topic, command_topic  resolved names: rclpy does not remap those whose publishers it counts
    joints                      names of the own joints
    """

    def __init__(self, node: Any, joint_topic: str, command_topic: str, joints: Sequence[str]) -> None:
        self._node, self._topics, self._joints = node, (joint_topic, command_topic), set(joints)
        self._decoder = JointStateDecoder()
        self._own: deque[int] = deque(maxlen=KEPT)
        self._ear: Any = None
        self._began = 0.0  # [s] steady clock
        self._heard = float("-inf")  # [s] steady clock
        self._recent = RECENT * random.uniform(1.0, 2.0)  # of two that wait for each other, one begins first

    @property
    def listens(self) -> bool:
        return self._ear is not None

    def sent(self, stamp: int) -> None:
        """Take note of an own sample with this stamp [ns]."""
        self._own.append(stamp)

    def look(self) -> None:
        """Compare with the graph."""
        joint_topic, command_topic = self._topics
        # Both counts are cheap; the names of the nodes take two periods of a loop at 1 kHz.
        possible = self._node.count_publishers(joint_topic) > 1 and self._node.count_subscribers(command_topic) > 1
        several = possible and len(drivers(self._node, *self._topics)) > 1
        if several and self._ear is None:
            self._began = time.monotonic()
            self._ear = self._node.create_subscription(JointState, self._topics[0], self._hear, qos.SAMPLES, raw=True)
        elif not several and self._ear is not None:
            self._node.destroy_subscription(self._ear)
            self._ear = None

    def is_alone(self) -> bool:
        """Whether no other driver was heard; False as long as it is not known."""
        now = time.monotonic()
        return self._ear is None or (now - self._began > PATIENCE and now - self._heard > self._recent)

    def is_mixed(self) -> bool:
        """Whether another one was heard within RECENT."""
        return time.monotonic() - self._heard <= RECENT

    def _hear(self, data: bytes) -> None:
        joints = self._decoder.decode(data)
        if joints is not None and joints.stamp not in self._own and not self._joints.isdisjoint(joints.names.joints):
            self._heard = time.monotonic()


def _names(infos: Iterable[Any]) -> list[str]:
    return sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)
