"""Estimates of one device, live: /joint_states and its commands in, stiffness, damping and motor estimates out.

ros2 run via_estimators estimator --ros-args -p device:=cubic_demo

Each sample gives one message per topic, stamped as the sample and numbered. What the rows are made of says
via_estimators.rows. The estimator's own parameters (window, memory, ...) start from what the device file says.
"""

from __future__ import annotations

import array
import sys
from bisect import insort
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_interfaces.msg import DampingEstimate, MotorEstimate, StiffnessEstimate, VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import SampleReader, command_of, nanoseconds
from via_ros.parameters import declare
from via_ros.spin import STEADY, run

from via_estimators.contract import Estimate, Parameters
from via_estimators.methods import METHODS, estimator_for, method_for

REPORT = 1.0  # [s] between two diagnostics
MOST_PENDING = 2 * qos.SAMPLES.depth  # commands that wait for a sample as late as they are


@dataclass(frozen=True)
class NodeParameters:
    device: str = field(default="cubic_demo", metadata={"description": "name of a device or path of its file"})
    method: str = field(default="auto", metadata={"description": "which estimator", "choices": ("auto", *METHODS)})
    joint_topic: str = field(default="/joint_states", metadata={"description": "topic of the samples"})


class EstimatorNode(Node):
    def __init__(self, **node_options: object) -> None:
        super().__init__("estimator", **node_options)
        own = declare(self, NodeParameters)
        self.device = load_device(own.device)
        self.method = method_for(self.device, own.method)
        suited = estimator_for(self.device, self.method)
        self.estimator = suited.having(self._declared(suited.parameters))
        self.state = self.estimator.init()
        # A sample that tells nothing: loads the compiled kernel now and not when the first real one waits.
        self.estimator.step(self.state, np.full(1 + len(self.estimator.inputs), np.nan))
        self._listen_anew()
        self._commanded = any(name in self.estimator.inputs for name in ("equilibrium", "preset", "damping"))
        self._late = self._refused = self._strangers = self._sequence = self._reported = 0
        self._messages: list[tuple[Any, Any]] = []
        self._make_messages()
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_service(ResetEstimator, "~/reset", self._reset)
        if self._commanded:
            self.create_subscription(VsaCommand, self.device.command_topic, self._hold, qos.SAMPLES)
        self.create_subscription(JointState, own.joint_topic, self._take, qos.SAMPLES)
        self.create_timer(REPORT, self._report, clock=STEADY)

    def _listen_anew(self) -> None:
        """As before the first message: no origin of time, no command held or waiting."""
        self._reader = SampleReader(self.device, self.estimator.inputs)
        self._pending: list[VsaCommand] = []  # by stamp
        self._newest = -(2**63)  # [ns] latest stamp taken

    def _declared(self, suited: Parameters) -> Parameters:
        """The estimator's parameters as ROS parameters, the device's values their defaults."""
        entries = [
            (item.name, item.type, field(default=getattr(suited, item.name), metadata=item.metadata))
            for item in fields(suited)
        ]
        kind = make_dataclass(type(suited).__name__, entries, bases=(Parameters,), frozen=True)
        return type(suited)(**vars(declare(self, kind)))

    def _make_messages(self) -> None:
        """One reused message and publisher per kind of estimate that the method gives."""
        outputs, name = self.estimator.outputs, self.device.name
        each = [at for at, output in enumerate(outputs) if output.startswith("stiffness_")]
        inertia = [at for at, output in enumerate(outputs) if output.startswith("motor_inertia_")]
        damping = [at for at, output in enumerate(outputs) if output.startswith("motor_damping_")]
        self._scalars: list[tuple[Any, int]] = []
        self._arrays: list[tuple[np.ndarray, np.ndarray, list[int]]] = []
        if "stiffness" in outputs:
            message = self._offer(StiffnessEstimate, f"/{name}/stiffness")
            self._scalars.append((message, outputs.index("stiffness")))
            self._arrays.append(
                (
                    _view(message, "transmission_value", each),
                    _view(message, "transmission_standard_deviation", each),
                    each,
                )
            )
        if "damping" in outputs:
            self._scalars.append((self._offer(DampingEstimate, f"/{name}/damping"), outputs.index("damping")))
        if inertia:
            message = self._offer(MotorEstimate, f"/{name}/motor")
            for member, places in (("inertia", inertia), ("damping", damping)):
                values, deviations = (
                    _view(message, member, places),
                    _view(message, f"{member}_standard_deviation", places),
                )
                self._arrays.append((values, deviations, places))

    def _offer(self, kind: Any, topic: str) -> Any:
        message = kind(method=self.method)
        message.header.frame_id = self.device.name
        self._messages.append((message, self.create_publisher(kind, topic, qos.SAMPLES)))
        return message

    def _hold(self, message: VsaCommand) -> None:
        if message.mode != VsaCommand.EQUILIBRIUM_PRESET or command_of(message, self.device.n_motors) is None:
            self._refused += 1
            return
        stamp = nanoseconds(message.header.stamp)
        self._late += stamp <= self._newest
        # By stamp, so that one from a far future does not hold back those that come after it.
        insort(self._pending, message, key=lambda each: nanoseconds(each.header.stamp))
        if len(self._pending) > MOST_PENDING:
            self._pending.pop()
            self._refused += 1

    def _take(self, message: JointState) -> None:
        stamp = nanoseconds(message.header.stamp)
        while self._pending and nanoseconds(self._pending[0].header.stamp) <= stamp:
            self._reader.hold(self._pending.pop(0))
        row = self._reader.read(message)
        if row is None:
            if not self._strangers:
                self.get_logger().warning(
                    f"no '{self.device.link_joint}' of device '{self.device.name}' among: {', '.join(message.name)}"
                )
            self._strangers += 1
            return
        self._newest = max(self._newest, stamp)
        self.state, estimate = self.estimator.step(self.state, row)
        self._publish(message.header.stamp, estimate)

    def _publish(self, stamp: Any, estimate: Estimate) -> None:
        for message, at in self._scalars:
            message.value, message.standard_deviation = estimate.value.item(at), estimate.standard_deviation.item(at)
        for values, deviations, places in self._arrays:
            values[:], deviations[:] = estimate.value[places], estimate.standard_deviation[places]
        for message, publisher in self._messages:
            message.header.stamp = stamp
            message.sequence = self._sequence
            message.status = int(estimate.status)
            publisher.publish(message)
        self._sequence += 1

    def _reset(self, _: ResetEstimator.Request, answer: ResetEstimator.Response) -> ResetEstimator.Response:
        samples = self.estimator.health(self.state).samples
        self.state = self.estimator.init()
        # What comes next may be another log: a command of the last one must not hold in it.
        self._listen_anew()
        answer.success, answer.message = True, f"{samples} samples of {self.device.name} forgotten"
        return answer

    def _report(self) -> None:
        health = self.estimator.health(self.state)
        rate, self._reported = (self._sequence - self._reported) / REPORT, self._sequence
        troubles = {
            "no samples": rate == 0.0,
            "joints of other devices only": self._strangers > 0 and self._sequence == 0,
            "bad samples": health.bad > 0,
            "gaps": health.gaps > 0,
            "late commands": self._late > 0,
            "refused commands": self._refused > 0,
            "malformed messages": self._reader.malformed > 0,
        }
        told = [text for text, holds in troubles.items() if holds]
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
            name=f"{self.get_name()}: {self.method}",
            message=", ".join(told) or health.status.name,
            hardware_id=self.device.name,
        )
        values: dict[str, str | float] = {
            "status": health.status.name, "rate [Hz]": rate, "samples": health.samples, "bad samples": health.bad,
            "gaps": health.gaps, "motion in the window [rad]": health.motion, "condition number": health.condition,
            "late commands": self._late, "refused commands": self._refused, "foreign messages": self._strangers,
            "malformed messages": self._reader.malformed,
        }  # fmt: skip
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)


def _view(message: Any, member: str, places: list[int]) -> np.ndarray:
    """Make the array member of a message as long as `places` and return a view to write through."""
    setattr(message, member, array.array("d", [0.0] * len(places)))
    return np.frombuffer(getattr(message, member))


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def main() -> int:
    return run(EstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
