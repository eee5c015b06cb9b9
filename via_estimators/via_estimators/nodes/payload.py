"""Node `payload`: payload at the tip of an arm of flexible joints and friction of its links, from its joint states.

ros2 run via_estimators payload --ros-args -p arm:=reference_4dof

subscribes  /joint_states    sensor_msgs/JointState with all links and motors of the arm: angles, and the motors'
                             efforts, the torques over the interval that ends at the stamp
publishes   /<arm>/payload   via_interfaces/PayloadEstimate, one for each sample
            /diagnostics     once per second of wall time
offers      ~/reset          via_interfaces/ResetEstimator: forget all samples

The method and its parameters: via_estimators.payload. Springs do not enter, so that they may differ from the file.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from via_core.parameters import parameter
from via_core.status import Status
from via_core.vsa_arms import load_vsa_arm
from via_core.wire import link_name, motor_name
from via_interfaces.msg import PayloadEstimate
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import JointReader, Joints, set_stamp
from via_ros.gate import SampleStream
from via_ros.parameters import declare
from via_ros.reports import StatusReport, report
from via_ros.serialised import JOINT_STATES
from via_ros.spin import STEADY, run

from via_estimators.contract import Live
from via_estimators.payload import SIGNALS, Payload, PayloadParameters

REPORT = 1.0  # [s] between two diagnostics
PLACES = {  # signal -> array of a JointState, and whether it is of the motor
    "q": ("position", False), "theta": ("position", True), "tau": ("effort", True)
}  # fmt: skip


@dataclass(frozen=True)
class PayloadNodeParameters:
    """Parameters of `payload` besides those of its method."""

    arm: str = parameter("reference_4dof", "arm name or path to its YAML")


class PayloadNode(Node):
    """The estimator of one arm."""

    def __init__(self, **options: Any) -> None:
        super().__init__("payload", **options)
        arm = load_vsa_arm(declare(self, PayloadNodeParameters).arm)
        self._live = Live(Payload(arm, declare(self, PayloadParameters)))
        self._live.estimator.load()
        self._reader = JointReader([_wanted(arm.joints)])
        self._reported = 0
        self._status = StatusReport(self, arm.name)
        self._message = PayloadEstimate(method="payload")
        self._message.header.frame_id = arm.name
        self._estimates = self.create_publisher(PayloadEstimate, f"{arm.name}/payload", qos.SAMPLES)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_service(ResetEstimator, "~/reset", self._reset)
        self._samples = SampleStream(self, JOINT_STATES, self._reader, self._take, qos.SAMPLES)
        self.create_timer(REPORT, self._report, clock=STEADY)

    def _take(self, joints: Joints, rows: list[int]) -> None:
        if not rows:
            return
        message = self._message
        message.status = int(self._live.take(self._reader.rows[0]))
        value, sd = self._live.value.tolist(), self._live.standard_deviation.tolist()
        message.value, message.standard_deviation = value[0], sd[0]
        message.link_friction, message.link_friction_standard_deviation = value[1:], sd[1:]
        set_stamp(message.header.stamp, joints.stamp)
        self._estimates.publish(message)
        message.sequence += 1

    def _reset(self, _: ResetEstimator.Request, answer: ResetEstimator.Response) -> ResetEstimator.Response:
        samples = self._live.health().samples
        self._live.restart()
        self._reader.origins[0] = None
        answer.success, answer.message = True, f"{samples} samples forgotten"
        return answer

    def _report(self) -> None:
        health, count = self._live.health(), self._message.sequence - self._reported
        self._reported = self._message.sequence
        malformed = self._samples.malformed()
        conditions = {
            **self._samples.conditions(count == 0, unusable=self._message.status == Status.BAD_SAMPLE),
            "impossible payload: check signs and units of efforts, and the arm file":
                health.status is Status.IMPLAUSIBLE,
        }  # fmt: skip
        events = {"bad samples": health.bad, "gaps": health.gaps, "malformed messages": malformed}
        values = {"status": health.status.name, "rate [Hz]": count / REPORT, "samples": health.samples, **events}
        report(self, self._reports, [self._status.status(conditions, events, values, health.status.name)])


def _wanted(joints: tuple[str, ...]) -> tuple[tuple[str, ...], list[tuple[str, str] | None]]:
    """Names that a message must have, and the entries of a sample in the order of `Payload.inputs`."""
    names = {False: [link_name(joint) for joint in joints], True: [motor_name(joint, 1) for joint in joints]}
    entries: list[tuple[str, str] | None] = []
    for signal in SIGNALS:
        array, of_motor = PLACES[signal]
        entries += [(array, name) for name in names[of_motor]]
    return (*names[False], *names[True]), entries


main = partial(run, PayloadNode)  # the executable


if __name__ == "__main__":
    sys.exit(main())
