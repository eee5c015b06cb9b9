"""Node `gap_monitor`: the nominal model beside the robot; where they differ, by how much, and why.

ros2 run via_gap gap_monitor --ros-args -p device:=cubic_demo
ros2 action send_goal -f /gap_monitor/diagnose via_interfaces/action/DiagnoseGap "{seconds: 10.0}"

subscribes  /joint_states       sensor_msgs/JointState, what the robot's sensors read
            /<device>/command   via_interfaces/VsaCommand
publishes   /<device>/gap       via_interfaces/GapStatus, at `rate`, stamped with the newest sample
            /diagnostics        at the same rate
offers      ~/diagnose          action via_interfaces/DiagnoseGap, of the window or of a recording; one goal at a time

Two things go on. At every tick the last `recent` seconds are held against the model (via_gap.run.watch): error, and the
share of each site. Every now and then the whole window is diagnosed as `via gap diagnose` does it with a bag, by the
same code, in a process of its own: the ticks go on meanwhile. What it finds is told with the stamp of its last sample,
and from then on the model has the device's numbers as it tuned them. A goal ends a diagnosis of the node's own.

While a goal is under way its state is ACCEPTED: a callback that waited for its end would keep rclpy's events executor
turning idle circles, so it is executed when the answer is there.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import ParameterError, SignalError, ViaError
from via_core.status import Status
from via_core.wire import SECOND
from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import GapStatus, VsaCommand
from via_ros import qos
from via_ros.conversions import RowReader, nanoseconds, set_stamp
from via_ros.parameters import declare
from via_ros.serialised import JointStateDecoder
from via_ros.spin import STEADY, run
from via_sim.effects import place_name

from via_gap.logs.log import JointLog
from via_gap.logs.rolling import RollingLog, columns_of
from via_gap.nodes.answers import failure, hypotheses_of, result_of, sites_of
from via_gap.rendering.words import headline
from via_gap.report.report import GapReport, read_report
from via_gap.run.watch import Look, Watch, rehearse, tuned
from via_gap.run.worker import Finished, Job, Progress, Worker

STALE = 0.5  # [s] of wall time without a sample
LIVE = "live"  # what a window is called in its report


@dataclass(frozen=True)
class MonitorParameters:
    """Parameters of the node."""

    device: str = field(default="cubic_demo", metadata={"description": "device name or path to its YAML"})
    joint_topic: str = field(default="/joint_states", metadata={"description": "topic of the samples"})
    rate: float = field(
        default=10.0, metadata={"description": "gap messages and diagnostics", "unit": "Hz", "range": (0.1, 50.0)}
    )
    recent: float = field(
        default=2.0,
        metadata={"description": "stretch held against the model at every tick", "unit": "s", "range": (0.5, 60.0)},
    )
    window: float = field(
        default=20.0, metadata={"description": "stretch that is diagnosed", "unit": "s", "range": (2.0, 600.0)}
    )
    least: float = field(
        default=8.0,
        metadata={"description": "stretch that suffices for a first diagnosis", "unit": "s", "range": (1.0, 600.0)},
    )
    every: float = field(
        default=20.0,
        metadata={
            "description": "time between the beginnings of the node's own diagnoses; 0: only on request",
            "unit": "s",
            "range": (0.0, 86400.0),
        },
    )


class MonitorNode(Node):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("gap_monitor", **options)
        self._chosen = own = declare(self, MonitorParameters)
        if own.recent > own.window:
            raise ParameterError(f"parameter recent must lie in [0.5, {own.window:g}] s, got {own.recent:g}")
        self.device = self._model = load_device(own.device)
        rehearse(self.device)
        self._rolling = RollingLog(self.device, own.window)
        self._reader = RowReader([(self.device, columns_of(self.device))])
        self._decoder = JointStateDecoder()
        self._worker = Worker()
        self._goal: ServerGoalHandle | None = None
        self._report: GapReport | None = None
        self._diagnosed = self._asked = 0  # [ns] stamps: of the report, of the diagnosis under way
        self._doing, self._restarts, self._refusal = "", 0, ""
        self._look: Look | None = None
        self._observer = Watch()
        self._trouble = ""
        self._seen = self._samples = self._foreign = self._broken = self._ticks = 0
        self._heard = self._due = float("-inf")  # [s] steady clock: of the last sample, of the next own diagnosis
        self._cost = 0.0  # [s] of the last tick
        self._message = GapStatus()
        self._message.header.frame_id = self.device.name
        self._gap = self.create_publisher(GapStatus, f"/{self.device.name}/gap", qos.CONTROL)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_subscription(JointState, own.joint_topic, self._take, qos.SAMPLES, raw=True)
        self.create_subscription(VsaCommand, self.device.command_topic, self._hold, qos.SAMPLES)
        self._server = ActionServer(
            self, DiagnoseGap, "~/diagnose", partial(_conclude, failure("no outcome")),
            goal_callback=self._consider, handle_accepted_callback=self._accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.create_timer(1.0 / own.rate, self._tick, clock=STEADY)

    def close(self, _failed: bool = False) -> None:
        """End the process of a diagnosis under way."""
        self._worker.close()
        self._server.destroy()

    # ---- what comes in

    def _take(self, data: bytes) -> None:
        joints = self._decoder.decode(data)
        if joints is None:
            self._broken += 1
        elif self._reader.read(joints):
            self._rolling.sample(joints.stamp, self._reader.rows[0][0, 1:])
            self._heard = time.monotonic()
            self._samples += 1
        else:
            self._foreign += 1

    def _hold(self, message: VsaCommand) -> None:
        motor = np.asarray(message.motor, dtype=float)
        stamp = nanoseconds(message.header.stamp)
        self._rolling.command(stamp, message.mode, message.equilibrium, message.preset, message.damping, motor)

    # ---- goals

    def _consider(self, _: DiagnoseGap.Goal) -> GoalResponse:
        if self._goal is None:
            return GoalResponse.ACCEPT
        self._refusal = f"a goal was refused: one at a time, and the last one is at '{self._doing}'"
        self.get_logger().warning(self._refusal)
        return GoalResponse.REJECT

    def _accept(self, goal: ServerGoalHandle) -> None:
        self._goal, self._doing = goal, "beginning"
        try:
            job = Job(self.device, self._source(goal.request), self._chosen.joint_topic)
        except ViaError as error:
            self._end_goal(failure(str(error)))
            return
        if self._worker.busy:
            self._worker.cancel()
        self._worker.begin(job)

    def _source(self, request: DiagnoseGap.Goal) -> JointLog | Path:
        """What a goal asks for. Raises ViaError where it cannot be had."""
        if request.path:
            if request.seconds != 0.0:
                raise ParameterError(f"seconds must be 0 with a path, got {request.seconds:g}")
            return Path(request.path)
        if not 0.0 <= request.seconds <= self._chosen.window:
            raise ParameterError(f"seconds must lie in [0, {self._chosen.window:g}], got {request.seconds:g}")
        log = self._rolling.log(LIVE, request.seconds or None)
        if log is None:
            raise SignalError(f"no samples of '{self.device.name}' yet on {self._chosen.joint_topic}")
        self._asked = self._rolling.newest or 0
        return log

    def _end_goal(self, outcome: DiagnoseGap.Result) -> None:
        """Answer the goal with this outcome."""
        assert self._goal is not None
        goal, self._goal, self._doing = self._goal, None, ""
        goal.execute(partial(_conclude, outcome))

    # ---- ticks

    def _tick(self) -> None:
        begin = time.perf_counter()
        if self._rolling.restarts != self._restarts:
            self._forget()
        self._hear()
        if self._goal is not None and self._goal.is_cancel_requested:
            self._worker.cancel()
            self._end_goal(failure("cancelled"))
        status, message = self._watch()
        self._diagnose_by_itself()
        self._tell(status, message)
        self._cost = time.perf_counter() - begin

    def _forget(self) -> None:
        """The clock ran back: what was found belongs to another run."""
        self._restarts = self._rolling.restarts
        self._report, self._model, self._look, self._due = None, self.device, None, float("-inf")
        self._observer = Watch()
        if self._worker.busy and self._goal is None:
            self._worker.cancel()
            self._doing = ""

    def _hear(self) -> None:
        """What the diagnosis under way has said since the last tick."""
        while (said := self._worker.poll()) is not None:
            if isinstance(said, Progress):
                self._doing = said.doing
                if self._goal is not None:
                    self._goal.publish_feedback(DiagnoseGap.Feedback(doing=said.doing, share=float(said.share)))
            elif isinstance(said, Finished):
                self._found(read_report(said.report, "diagnosis"))
            elif self._goal is not None:
                self._end_goal(failure(said.reason))
            else:
                self._doing, self._trouble = "", said.reason

    def _found(self, report: GapReport) -> None:
        asked_for_file = self._goal is not None and bool(self._goal.request.path)
        if not asked_for_file:
            self._report, self._diagnosed = report, self._asked
            self._model = tuned(self.device, report)
        self._doing = ""
        if self._goal is not None:
            self._end_goal(result_of(report))

    def _watch(self) -> tuple[Status, str]:
        """Hold the last samples against the model -> what that is worth, and why."""
        topic, own = self._chosen.joint_topic, self._chosen
        if self._rolling.newest is None:
            others = " of this device, others only" if self._foreign else ""
            return Status.WARMING_UP, f"no samples{others} yet on {topic}"
        silent = time.monotonic() - self._heard
        if silent > STALE:
            return Status.BAD_SAMPLE, f"no samples for {silent:.1f} s on {topic}"
        if self._rolling.duration < own.recent:
            why = "the clock ran back, the window began anew" if self._restarts else "warming up"
            return Status.WARMING_UP, f"{why}: {self._rolling.duration:.1f} of {own.recent:g} s"
        if self._samples != self._seen:
            self._seen = self._samples
            try:
                log = self._rolling.log(LIVE, own.recent)
                assert log is not None
                self._look = self._observer.look(log, self._model)
            except ViaError as error:
                self._look = None
                return Status.BAD_SAMPLE, str(error)
        if self._look is None:
            return Status.BAD_SAMPLE, self._trouble or "nothing could be compared"
        if not self._look.moves:
            return Status.NOT_EXCITED, "the link stands still"
        told = f"the equations leave {self._look.residual_ratio:.3g} times the noise"
        if self._look.sites:
            told += f", most at the {self._look.sites[0].site}"
        return Status.OK, told

    def _diagnose_by_itself(self) -> None:
        own, now = self._chosen, time.monotonic()
        moves = self._look is not None and self._look.moves and now - self._heard <= STALE
        enough = self._rolling.duration >= min(own.least, own.window)
        if own.every == 0.0 or self._worker.busy or self._goal is not None or now < self._due or not (moves and enough):
            return
        self._due = now + own.every
        try:
            log = self._rolling.log(LIVE)
        except ViaError as error:
            self._trouble = str(error)
            return
        if log is not None:
            self._asked, self._doing, self._trouble = self._rolling.newest or 0, "beginning", ""
            self._worker.begin(Job(self.device, log))

    # ---- what goes out

    def _tell(self, status: Status, said: str) -> None:
        message, found, report = self._message, self._look, self._report
        newest = self._rolling.newest or 0
        set_stamp(message.header.stamp, newest)
        message.sequence = self._ticks
        self._ticks += 1
        known = found if status != Status.WARMING_UP else None
        unknown = float("nan")
        message.window = known.window if known else 0.0
        message.error = known.error if known else unknown
        message.normalised_error = known.normalised_error if known else unknown
        message.residual_ratio = known.residual_ratio if known else unknown
        message.sites = sites_of(known.sites) if known else []
        message.hypotheses = hypotheses_of(report) if report is not None else []
        message.status = int(status)
        message.method = "nominal model" if self._model is self.device else "tuned model"
        message.verdict = report.verdict if report is not None else ""
        set_stamp(message.diagnosed, self._diagnosed if report is not None else 0)
        age = (newest - self._diagnosed) / SECOND
        if report is not None:
            said = f"{said}; {age:.0f} s ago: {headline(report)}"
        message.message = said
        self._gap.publish(message)
        self._reports.publish(self._diagnostics(status, said, age))

    def _diagnostics(self, status: Status, said: str, age: float) -> DiagnosticArray:
        message, report = self._message, self._report
        silent = status == Status.BAD_SAMPLE and self._look is not None
        sites = ", ".join(f"{place_name(s.site, s.motor)} {100 * s.share:.0f} %" for s in message.sites)
        causes = ", ".join(f"{h.effect.name} {100 * h.probability:.0f} %" for h in message.hypotheses)
        values: dict[str, str | float] = {
            "status": status.name, "residual ratio [-]": message.residual_ratio, "error [rad]": message.error,
            "normalised error [-]": message.normalised_error, "sites": sites, "model": message.method,
            "verdict": message.verdict, "causes": causes,
            "age of the diagnosis [s]": age if report is not None else float("nan"),
            "diagnosing": self._doing, "trouble of the last diagnosis": self._trouble, "refused goal": self._refusal,
            "window [s]": self._rolling.duration, "samples": self._samples, "foreign messages": self._foreign,
            "malformed messages": self._broken + self._reader.malformed[0], "clock ran back": self._restarts,
            "last tick [ms]": 1e3 * self._cost,
        }  # fmt: skip
        level = DiagnosticStatus.WARN
        if silent:
            level = DiagnosticStatus.STALE
        elif status == Status.OK and message.verdict in ("", "no_gap"):
            level = DiagnosticStatus.OK
        array = DiagnosticArray(
            status=[
                DiagnosticStatus(
                    level=level,
                    name=f"{self.get_name()}: {self.device.name}",
                    message=said,
                    hardware_id=self.device.name,
                    values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
                )
            ]
        )
        array.header.stamp = self.get_clock().now().to_msg()
        return array


def _conclude(outcome: DiagnoseGap.Result, goal: ServerGoalHandle) -> DiagnoseGap.Result:
    """Called by the action server for a goal that has its outcome."""
    if goal.is_cancel_requested:
        goal.canceled()
    elif outcome.success:
        goal.succeed()
    else:
        goal.abort()
    return outcome


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def main() -> int:
    return run(MonitorNode)


if __name__ == "__main__":
    sys.exit(main())
