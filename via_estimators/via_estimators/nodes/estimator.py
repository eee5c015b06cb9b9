"""Estimates of any number of devices, live: joint states and commands in, stiffness, damping and motor estimates out.

ros2 run via_estimators estimator --ros-args -p device:=cubic_demo
ros2 run via_estimators estimator --ros-args -p "devices:=[shoulder=qbmove_a, elbow=qbmove_a]"
ros2 run via_estimators estimator_bank --ros-args -p device:=cubic_demo
ros2 run via_estimators modulated_torque --ros-args -p device:=cubic_demo

estimator       one method per device, on /<device>/stiffness, /<device>/damping and /<device>/motor
estimator_bank  several methods side by side on the same samples, on /<device>/<method>/stiffness and so on
<method>        the estimator with its method fixed (nodes/single.py)

Each sample gives one message per topic, stamped as the sample and numbered. What the rows are made of says
via_estimators.rows; joint states may come as one message for all devices or as one for each. The parameters of a method
(window, memory, ...) start from what the device file says; where a node runs more than one method or device they are
called <device>.<method>.<name>.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_interfaces.msg import VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import RowReader
from via_ros.parameters import declare
from via_ros.serialised import JointStateDecoder
from via_ros.spin import STEADY, run

from via_estimators.contract import Estimator, Parameters
from via_estimators.methods import METHODS, Pair, estimator_for, pairs_of
from via_estimators.nodes.line import Line
from via_estimators.nodes.station import REPORT, Station

DEFAULT_DEVICE = "cubic_demo"


@dataclass(frozen=True)
class NodeParameters:
    device: str = field(
        default=DEFAULT_DEVICE,
        metadata={"description": "name of a device, path of its file, or new_name=either"},
    )
    devices: tuple[str, ...] = field(default=(), metadata={"description": "several devices instead of one"})
    joint_topic: str = field(default="/joint_states", metadata={"description": "topic of the samples"})


@dataclass(frozen=True)
class EstimatorParameters(NodeParameters):
    method: str = field(
        default="auto", metadata={"description": "which estimator; auto: the best", "choices": ("auto", *METHODS)}
    )


@dataclass(frozen=True)
class BankParameters(NodeParameters):
    methods: tuple[str, ...] = field(
        default=("all",),
        metadata={"description": "which estimators, each where it suits; auto: the best, all: all that suit"},
    )


@dataclass(frozen=True)
class Kind:
    """A sort of node: its name, its parameters, which methods those ask for, and where estimates are published."""

    name: str
    parameters: type[NodeParameters]
    methods: Callable[[Any], Sequence[str]]
    topic: Callable[[Pair], str]


ESTIMATOR = Kind("estimator", EstimatorParameters, lambda given: (given.method,), lambda pair: f"/{pair.device.name}")
BANK = Kind(
    "estimator_bank", BankParameters, lambda given: given.methods, lambda pair: f"/{pair.device.name}/{pair.method}"
)


def single(method: str) -> Kind:
    """A node of that one method."""
    return Kind(method, NodeParameters, lambda _: (method,), lambda pair: f"/{pair.device.name}")


class EstimatorNode(Node):
    """Any number of methods on any number of devices."""

    def __init__(self, kind: Kind = ESTIMATOR, **node_options: object) -> None:
        super().__init__(kind.name, **node_options)
        own = declare(self, kind.parameters)
        pairs = pairs_of([load_device(name) for name in _names(own)], kind.methods(own))
        estimators = [self._set_up(pair, several=len(pairs) > 1) for pair in pairs]
        self._lines = [
            Line(self, *pair, estimator, kind.topic(pair)) for pair, estimator in zip(pairs, estimators, strict=True)
        ]
        self._reader = RowReader(
            [(pair.device, estimator.inputs) for pair, estimator in zip(pairs, estimators, strict=True)]
        )
        self._decoder = JointStateDecoder()
        rows: dict[str, list[int]] = {}
        for row, pair in enumerate(pairs):
            rows.setdefault(pair.device.name, []).append(row)
        self.stations = [Station([self._lines[row] for row in each], each, self._reader) for each in rows.values()]
        self._station_of = [next(each for each in self.stations if line in each.lines) for line in self._lines]
        self._foreign = self._broken = self._turn = 0
        self._share, self._used, self._since = 0.0, time.process_time(), time.monotonic()
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_service(ResetEstimator, "~/reset", partial(_reset, self.stations))
        for station in self.stations:
            self.create_service(ResetEstimator, f"~/{station.device.name}/reset", partial(_reset, [station]))
            if station.commanded:
                self.create_subscription(VsaCommand, station.device.command_topic, station.hold, qos.SAMPLES)
        self.create_subscription(JointState, own.joint_topic, self._take, qos.samples_of(len(self.stations)), raw=True)
        # One device at a time: a report of many would hold up the samples.
        self.create_timer(REPORT / len(self.stations), self._report, clock=STEADY)

    def _set_up(self, pair: Pair, several: bool) -> Estimator:
        """The estimator with its ROS parameters, whose defaults are the device's values."""
        estimator = estimator_for(*pair)
        suited = estimator.parameters
        entries = [
            (item.name, item.type, field(default=getattr(suited, item.name), metadata=item.metadata))
            for item in fields(suited)
        ]
        kind = make_dataclass(type(suited).__name__, entries, bases=(Parameters,), frozen=True)
        prefix = f"{pair.device.name}.{pair.method}" if several else ""
        return estimator.having(type(suited)(**vars(declare(self, kind, prefix))))

    def _take(self, data: bytes) -> None:
        joints = self._decoder.decode(data)
        if joints is None:
            self._broken += 1
            return
        rows = self._reader.read(joints)
        for row in rows:
            self._station_of[row].reach(joints.stamp)
            self._lines[row].take(self._reader.rows[row], joints.stamp_bytes)
        if not rows:
            if not self._foreign:
                wanted = ", ".join(f"'{each.device.link_joint}' of '{each.device.name}'" for each in self.stations)
                self.get_logger().warning(f"no {wanted} among: {', '.join(joints.names.joints)}")
            self._foreign += 1

    def _report(self) -> None:
        if self._turn == 0:
            used, now = time.process_time(), time.monotonic()
            self._share = (used - self._used) / max(now - self._since, 1e-9)
            self._used, self._since = used, now
        station = self.stations[self._turn]
        self._turn = (self._turn + 1) % len(self.stations)
        report = DiagnosticArray(status=station.report(self.get_name(), self._foreign, self._broken, self._share))
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)


def _names(own: NodeParameters) -> tuple[str, ...]:
    if own.devices and own.device != DEFAULT_DEVICE:
        raise ParameterError("parameter devices: give one device or several, not both")
    return own.devices or (own.device,)


def _reset(
    stations: list[Station], _: ResetEstimator.Request, answer: ResetEstimator.Response
) -> ResetEstimator.Response:
    forgotten = ", ".join(f"{station.restart()} samples of {station.device.name}" for station in stations)
    answer.success, answer.message = True, f"{forgotten} forgotten"
    return answer


def main() -> int:
    return run(EstimatorNode)


def bank() -> int:
    return run(partial(EstimatorNode, BANK))


if __name__ == "__main__":
    sys.exit(main())
