"""Node `gap_monitor`: compares the robot with the nominal model, and diagnoses the difference.

ros2 run via_gap gap_monitor --ros-args -p device:=cubic_demo
via action send -f /gap_monitor/diagnose via_interfaces/action/DiagnoseGap "{seconds: 10.0}"

subscribes  /joint_states       sensor_msgs/JointState, the robot's measurements
            /<device>/command   via_interfaces/VsaCommand
publishes   /<device>/gap       via_interfaces/GapStatus, at `rate`, stamped with the newest sample
            /diagnostics        at the same rate
offers      ~/diagnose          action via_interfaces/DiagnoseGap, of the window or of a recording; one goal at a time

Every tick compares the last `recent` seconds with the model. At longer intervals the whole window is diagnosed in a
process of its own, with the same code and result as `via gap diagnose`. A goal ends such an automatic diagnosis.

A goal stays ACCEPTED until its result is there, and is executed then: a callback that waited for the result would keep
rclpy's events executor busy.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from via_core.errors import ViaError
from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import GapStatus, VsaCommand
from via_ros import qos
from via_ros.conversions import Joints, RowReader
from via_ros.gate import LOSSY, RenewedSubscription, SampleStream
from via_ros.parameters import declare
from via_ros.serialised import decoded_command
from via_ros.spin import STEADY, run

from via_gap.nodes.messages import diagnostics_of, failure, fill_status, result_of
from via_gap.run.monitor import Monitor, MonitorParameters
from via_gap.run.worker import Failed, Progress


class MonitorNode(Node):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("gap_monitor", **options)
        own = declare(self, MonitorParameters, changed=lambda parameters: self.monitor.changed(parameters))
        device = own.described()
        self.monitor = Monitor(device, own, self.resolve_topic_name(own.joint_topic))
        reader = RowReader([(device, self.monitor.columns)])
        self._goal: ServerGoalHandle | None = None
        self._refusal = ""
        self._broken = self._ticks = 0
        self._cost = 0.0  # [s] of the last tick
        self._message = GapStatus()
        self._message.header.frame_id = device.name
        self._gap = self.create_publisher(GapStatus, f"{device.name}/gap", qos.CONTROL)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self._samples = SampleStream(self, own.joint_topic, reader, self._on_sample, qos.SAMPLES)
        self._commands = RenewedSubscription(self, VsaCommand, device.command_name, self._on_command, qos.SAMPLES)
        self._server = ActionServer(
            self, DiagnoseGap, "~/diagnose", partial(_conclude, failure("no outcome")),
            goal_callback=self._consider, handle_accepted_callback=self._accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.create_timer(1.0 / own.rate, self._tick, clock=STEADY)

    def close(self, _failed: bool = False) -> None:
        """End the process of a diagnosis under way."""
        self.monitor.worker.close()
        self._server.destroy()

    def _on_sample(self, joints: Joints, rows: list[int]) -> None:
        if rows:
            self.monitor.sample(joints.stamp, self._samples.reader.rows[0][0, 1:], time.monotonic())
        else:
            self.monitor.foreign += 1

    def _on_command(self, data: bytes) -> None:
        decoded = decoded_command(data)
        if decoded is None:
            self._broken += 1
        else:
            self.monitor.rolling.command(decoded[0], *decoded[1])

    def _consider(self, _: DiagnoseGap.Goal) -> GoalResponse:
        if self._goal is None:
            return GoalResponse.ACCEPT
        self._refusal = f"a goal was refused: one at a time, and the last one is at '{self.monitor.doing}'"
        self.get_logger().warning(self._refusal)
        return GoalResponse.REJECT

    def _accept(self, goal: ServerGoalHandle) -> None:
        self._goal = goal
        try:
            self.monitor.request(goal.request.path, goal.request.seconds)
        except ViaError as error:
            self._end_goal(failure(str(error)))

    def _end_goal(self, outcome: DiagnoseGap.Result) -> None:
        """Answer the goal with this outcome."""
        assert self._goal is not None
        goal, self._goal = self._goal, None
        goal.execute(partial(_conclude, outcome))

    def _tick(self) -> None:
        begin, now = time.perf_counter(), time.monotonic()
        for event in self.monitor.poll():
            assert self._goal is not None
            if isinstance(event, Progress):
                self._goal.publish_feedback(DiagnoseGap.Feedback(doing=event.doing, share=float(event.share)))
            else:
                self._end_goal(failure(event.reason) if isinstance(event, Failed) else result_of(event))
        if self._goal is not None and self._goal.is_cancel_requested:
            self.monitor.cancel()
            self._end_goal(failure("cancelled"))
        status, text = self.monitor.compare(now)
        lossy = self._samples.is_lossy or self._commands.is_lossy
        text += f"; {LOSSY}" if lossy else ""
        self.monitor.diagnose_if_due(now)
        fill_status(self._message, self.monitor, status, text)
        self._message.sequence = self._ticks
        self._ticks += 1
        self._gap.publish(self._message)
        counters: dict[str, str | float] = {
            "refused goal": self._refusal, "malformed messages": self._broken + self._samples.malformed(),
            "last tick [ms]": 1e3 * self._cost,
        }  # fmt: skip
        array = DiagnosticArray(status=[diagnostics_of(self, self._message, self.monitor, counters, lossy)])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        self._cost = time.perf_counter() - begin


def _conclude(outcome: DiagnoseGap.Result, goal: ServerGoalHandle) -> DiagnoseGap.Result:
    """Called by the action server for a goal that has its outcome."""
    if goal.is_cancel_requested:
        goal.canceled()
    elif outcome.success:
        goal.succeed()
    else:
        goal.abort()
    return outcome


def main() -> int:
    return run(MonitorNode)


if __name__ == "__main__":
    sys.exit(main())
