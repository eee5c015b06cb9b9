"""Estimator nodes: joint states and commands of any number of devices in, stiffness, damping and motor estimates out.

ros2 run via_estimators estimator --ros-args -p device:=cubic_demo
ros2 run via_estimators estimator --ros-args -p "devices:=[shoulder=qbmove_a, elbow=qbmove_a]"
ros2 run via_estimators estimator_bank --ros-args -p device:=cubic_demo
ros2 run via_estimators modulated_torque --ros-args -p device:=cubic_demo

estimator       one method per device, publishes on /<device>/stiffness, /<device>/damping and /<device>/motor
estimator_bank  several methods side by side on the same samples, on /<device>/<method>/stiffness and so on
<method>        the estimator with a fixed method (nodes/single.py)

Each sample yields one numbered message per topic with the stamp of the sample. via_estimators.rows describes how
samples are formed; joint states may arrive as one message for all devices or one for each. The defaults of a method's
parameters (window, memory, ...) come from the device file; in a node with several methods or devices their names are
<device>.<method>.<name>.
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
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_interfaces.msg import VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import Joints, RowReader
from via_ros.gate import SampleStream
from via_ros.parameters import declare
from via_ros.reports import report
from via_ros.serialised import JOINT_STATES
from via_ros.spin import STEADY, run

from via_estimators.contract import Estimator, Parameters
from via_estimators.methods import METHODS, Pair, estimator_for, pairs_of
from via_estimators.nodes.channel import EstimatorChannel
from via_estimators.nodes.pipeline import REPORT, DevicePipeline

DEFAULT_DEVICE = "cubic_demo"


@dataclass(frozen=True)
class NodeParameters:
    device: str = field(
        default=DEFAULT_DEVICE,
        metadata={"description": "name of a device, path of its file, or new_name=either"},
    )
    devices: tuple[str, ...] = field(default=(), metadata={"description": "several devices instead of one"})
    joint_topic: str = field(default=JOINT_STATES, metadata={"description": "topic of the samples"})


@dataclass(frozen=True)
class EstimatorParameters(NodeParameters):
    method: str = field(
        default="auto",
        metadata={"description": "estimator; auto: the default of the device", "choices": ("auto", *METHODS)},
    )


@dataclass(frozen=True)
class BankParameters(NodeParameters):
    methods: tuple[str, ...] = field(
        default=("all",),
        metadata={"description": "estimators, each on the devices it suits; auto: the default, all: all that suit"},
    )


@dataclass(frozen=True)
class Kind:
    """A kind of node: its name, its parameters, the methods they select, and the topic of a pair's estimates."""

    name: str
    parameters: type[NodeParameters]
    methods: Callable[[Any], Sequence[str]]
    topic: Callable[[Pair], str]


ESTIMATOR = Kind("estimator", EstimatorParameters, lambda given: (given.method,), lambda pair: f"{pair.device.name}")
BANK = Kind(
    "estimator_bank", BankParameters, lambda given: given.methods, lambda pair: f"{pair.device.name}/{pair.method}"
)


def single(method: str) -> Kind:
    """The kind of node with one fixed method."""
    return Kind(method, NodeParameters, lambda _: (method,), lambda pair: f"{pair.device.name}")


class EstimatorNode(Node):
    """Any number of methods on any number of devices."""

    def __init__(self, kind: Kind = ESTIMATOR, **node_options: object) -> None:
        super().__init__(kind.name, **node_options)
        own = declare(self, kind.parameters)
        pairs = pairs_of([load_device(name) for name in _names(own)], kind.methods(own))
        estimators = [self._set_up(pair, several=len(pairs) > 1) for pair in pairs]
        self._channels = [
            EstimatorChannel(self, *pair, estimator, kind.topic(pair))
            for pair, estimator in zip(pairs, estimators, strict=True)
        ]
        self._reader = RowReader(
            [(pair.device, estimator.inputs) for pair, estimator in zip(pairs, estimators, strict=True)]
        )
        rows: dict[str, list[int]] = {}
        for row, pair in enumerate(pairs):
            rows.setdefault(pair.device.name, []).append(row)
        self.pipelines = [
            DevicePipeline([self._channels[row] for row in each], each, self._reader) for each in rows.values()
        ]
        self._pipeline_of = [
            next(each for each in self.pipelines if channel in each.channels) for channel in self._channels
        ]
        self._turn = 0
        self._share, self._used, self._since = 0.0, time.process_time(), time.monotonic()
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_service(ResetEstimator, "~/reset", partial(_reset, self.pipelines))
        for pipeline in self.pipelines:
            self.create_service(ResetEstimator, f"~/{pipeline.device.name}/reset", partial(_reset, [pipeline]))
            if pipeline.commanded:
                self.create_subscription(VsaCommand, pipeline.device.command_name, pipeline.hold, qos.SAMPLES)
        depth = qos.samples_of(len(self.pipelines))
        self._samples = SampleStream(self, own.joint_topic, self._reader, self._take, depth)
        # One device at a time, so that diagnostics do not delay samples.
        self.create_timer(REPORT / len(self.pipelines), self._report, clock=STEADY)
        chosen = ", ".join(f"{pair.device.name} by {pair.method}" for pair in pairs)
        self.get_logger().info(f"estimates {chosen}; waits for samples on {self.resolve_topic_name(own.joint_topic)}")

    def _set_up(self, pair: Pair, several: bool) -> Estimator:
        """The estimator with its ROS parameters; their defaults come from the device."""
        estimator = estimator_for(*pair)
        suited = estimator.parameters
        entries = [
            (item.name, item.type, field(default=getattr(suited, item.name), metadata=item.metadata))
            for item in fields(suited)
        ]
        kind = make_dataclass(type(suited).__name__, entries, bases=(Parameters,), frozen=True)
        prefix = f"{pair.device.name}.{pair.method}" if several else ""
        return estimator.with_parameters(type(suited)(**vars(declare(self, kind, prefix))))

    def _take(self, joints: Joints, rows: list[int]) -> None:
        for row in rows:
            if not self._channels[row].sequence:
                each = self._channels[row]
                self.get_logger().info(f"first sample of {each.device.name}: {each.method} publishes {each.topics}")
            self._pipeline_of[row].reach(joints.stamp)
            self._channels[row].take(self._reader.rows[row], joints.stamp_bytes)
        if not rows and self._reader.foreign == 1:
            self.get_logger().warning(self._reader.absent())

    def _report(self) -> None:
        if self._turn == 0:
            used, now = time.process_time(), time.monotonic()
            self._share = (used - self._used) / max(now - self._since, 1e-9)
            self._used, self._since = used, now
        pipeline = self.pipelines[self._turn]
        self._turn = (self._turn + 1) % len(self.pipelines)
        report(self, self._reports, pipeline.report(self._samples, self._share))


def _names(own: NodeParameters) -> tuple[str, ...]:
    if own.devices and own.device != DEFAULT_DEVICE:
        raise ParameterError("parameter devices: give one device or several, not both")
    return own.devices or (own.device,)


def _reset(
    pipelines: list[DevicePipeline], _: ResetEstimator.Request, answer: ResetEstimator.Response
) -> ResetEstimator.Response:
    forgotten = ", ".join(f"{pipeline.restart()} samples of {pipeline.device.name}" for pipeline in pipelines)
    answer.success, answer.message = True, f"{forgotten} forgotten"
    return answer


def main() -> int:
    return run(EstimatorNode)


def bank() -> int:
    return run(partial(EstimatorNode, BANK))


if __name__ == "__main__":
    sys.exit(main())
