"""What every simulator node shares: how time runs, whose command holds, when nobody's does, and what is reported.

publishes   /joint_states    sensor_msgs/JointState at every tick
            /clock           rosgraph_msgs/Clock in modes lockstep and free, before the sample of that time
            /diagnostics     once per second of wall time
subscribes  /<name>/command  via_interfaces/VsaCommand

Time begins when `listeners` subscribers of samples are there, so that nobody misses the first one.

realtime  ticks by the wall clock and catches up when late (counted); a command holds for 20 ms after the sample that it
          answers, or after its coming where its stamp is no sample's; from then on nothing drives the joints
lockstep  ticks exactly when the command with the stamp of the last sample arrives; waits for somebody who commands
free      ticks as fast as it can under the last command

A command that cannot be followed is ignored and counted, and so is one under which the numbers overflow.
"""

from __future__ import annotations

import sys
import time
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from via_core.errors import ParameterError
from via_core.wire import SECOND
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import Command, set_stamp
from via_ros.serialised import decoded_command
from via_ros.spin import STEADY

Row = TypeVar("Row")  # a command as the simulated body takes it

REPORT = 1.0  # [s] between two diagnostics
WATCHDOG = 20_000_000  # [ns] that a command holds in real time
GIVE_UP = 100_000_000  # [ns] late: time is let go instead of caught up with
LOOK = 0.02  # [s] between two looks whether everybody is there
SETTLED = 5  # looks in a row with everybody there: whoever was found has then found this node too
REPEAT = 100  # looks without an answer before a sample in lockstep is said again
EPOCH = SECOND  # [ns] stamp of the first sample in simulated time; 0 would mean 'no time' to ROS


@dataclass(frozen=True)
class TimeParameters:
    """Parameters of every simulator node."""

    mode: str = field(
        default="realtime", metadata={"description": "how time runs", "choices": ("realtime", "lockstep", "free")}
    )
    rate: float = field(default=1000.0, metadata={"description": "ticks", "unit": "Hz", "range": (1.0, 1e5)})
    duration: float = field(
        default=0.0, metadata={"description": "time to simulate; 0: no end", "unit": "s", "range": (0.0, 1e9)}
    )
    listeners: int = field(
        default=1,
        metadata={"description": "subscribers of samples to wait for before time begins", "range": (0, 100)},
    )


class SimulationNode(Node, Generic[Row]):
    """A body in simulated time; `finished` is done when `duration` has been simulated.

    A subclass says what its body is and calls `start_listening` when it is ready to be told what to do.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.finished = Future()
        self._tick = self._late = self._skipped = self._refused = self._unmatched = self._repeats = 0
        self._taken = self._overtaken = 0
        self._last = sys.maxsize
        self._running = False
        self._looks = self._reported = 0
        self._epoch, self._began = EPOCH, 0  # [ns] stamp of sample 0, and steady time of it
        self._joint_states = self.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self._clock_message = Clock()
        self._clock_publisher: Any = None
        self._pace: Any = None
        self._beside: list[Any] = []  # what else is published with every sample

    def start_listening(self, times: TimeParameters, name: str, command_topic: str) -> None:
        """Wait for everybody, then let time begin. `name` is that of the device or arm."""
        self._times, self._name = times, name
        if times.duration > 0.0:
            self._last = round(times.duration * times.rate)
        if self._last < 1:
            raise ParameterError(f"parameter duration must be 0 or at least a tick of {1.0 / times.rate:g} s")
        self._command = self._passive()
        self._heard = -WATCHDOG  # [ns] stamp from which on the command counts
        if times.mode != "realtime":
            self._clock_publisher = self.create_publisher(Clock, "/clock", qos.CONTROL)
        self._commands = self.create_subscription(VsaCommand, command_topic, self._take, qos.CONTROL, raw=True)
        self.create_timer(REPORT, self._report, clock=STEADY)
        self.create_timer(LOOK, self._look, clock=STEADY)

    # ---- the body

    @abstractmethod
    def _passive(self) -> Row:
        """The command under which nothing drives the body as it is now."""

    @abstractmethod
    def _row_of(self, command: Command) -> Row | None:
        """A command as the body takes it, or None where it cannot be commanded so."""

    @abstractmethod
    def _advance(self, command: Row) -> None:
        """One tick of the body under a command."""

    @abstractmethod
    def _sample(self, stamp: int) -> JointState:
        """What its sensors say now, with the stamp [ns]; says beside it whatever else is published."""

    @abstractmethod
    def _told(self) -> tuple[dict[str, bool], dict[str, Any]]:
        """Troubles of the body, and values for the diagnostics."""

    # ---- time

    def _after(self, ticks: int) -> int:
        """[ns] that `ticks` take, from sample 0 and without drift."""
        return round(ticks * SECOND / self._times.rate)

    def _keep_pace(self) -> None:
        """Realtime: every tick whose time has come."""
        now = time.monotonic_ns()
        behind = now - self._began - self._after(self._tick + 1)
        if behind > GIVE_UP:
            self._skipped += 1
            self._began += behind
            self._epoch += behind
            behind = 0
        while behind >= 0 and self._running:
            self._late += behind >= SECOND / self._times.rate
            # It is to hold until the end of the tick.
            if self._epoch + self._after(self._tick + 1) - self._heard > WATCHDOG:
                self._command = self._passive()
            self._step()
            behind = now - self._began - self._after(self._tick + 1)

    def _look(self) -> None:
        """Begin when everybody is there; in lockstep say a sample again that nobody answered."""
        self._looks += 1
        if not self._running:
            if not self._everybody_is_there():
                self._looks = 0
            elif self._looks >= SETTLED:
                self._begin()
        elif self._times.mode == "lockstep" and self._looks >= REPEAT:
            self._looks = 0
            self._repeats += 1
            self._joint_states.publish(self._said)

    def _everybody_is_there(self) -> bool:
        """Whether those to wait for are there, and everybody known on a topic of ours is connected to us."""
        lockstep = int(self._times.mode == "lockstep")
        commanders = max(self.count_publishers(self._commands.topic_name), lockstep)
        listeners = max(self._times.listeners, lockstep)
        own = (self._joint_states, *self._beside)
        return (
            self._tick < self._last
            and self._joint_states.get_subscription_count() >= listeners
            and self._commands.get_publisher_count() >= commanders
            and all(each.get_subscription_count() >= self.count_subscribers(each.topic_name) for each in own)
        )

    def _begin(self) -> None:
        self._running, self._looks = True, 0
        mode, rate = self._times.mode, self._times.rate
        if mode == "realtime":
            self._epoch, self._began = self.get_clock().now().nanoseconds, time.monotonic_ns()
            self._pace = self.create_timer(1.0 / rate, self._keep_pace, clock=STEADY)
        elif mode == "free":
            self._pace = self.create_timer(1e-6, self._step, clock=STEADY)
        self._publish()

    @property
    def ticks(self) -> int:
        """Since time began."""
        return self._tick

    @property
    def late_ticks(self) -> int:
        """Ticks that began more than one period late, in real time."""
        return self._late

    @property
    def late_commands(self) -> float:
        """Share of the commands that came when the sample after theirs had been said, not in lockstep."""
        return self._overtaken / max(self._taken, 1)

    def _stamp(self) -> int:
        return self._epoch + self._after(self._tick)

    def _step(self) -> None:
        if not self._running:
            return
        self._advance(self._command)
        self._tick += 1
        self._looks = 0
        if self._tick >= self._last:
            self._running = False
            if self._pace is not None:
                self._pace.cancel()
        self._publish()
        if not self._running:
            self.finished.set_result(0)

    def _publish(self) -> None:
        """The sample of this tick."""
        stamp = self._stamp()
        if self._clock_publisher is not None:
            set_stamp(self._clock_message.clock, stamp)
            self._clock_publisher.publish(self._clock_message)
        self._said = self._sample(stamp)
        self._joint_states.publish(self._said)

    # ---- commands

    def _take(self, data: bytes) -> None:
        told = decoded_command(data)
        row = None if told is None else self._row_of(told[1])
        if told is None or row is None:
            self._refused += 1
            return
        now, stamp = self._stamp(), told[0]
        if self._times.mode == "lockstep":
            if not self._running or stamp != now:
                self._unmatched += 1
                return
            self._command = row
            self._step()
            return
        known = self._epoch <= stamp <= now
        self._taken += 1
        self._overtaken += known and stamp < now
        self._command, self._heard = row, stamp if known else now

    # ---- diagnostics

    def _report(self) -> None:
        mode, silent = self._times.mode, self._stamp() - self._heard > WATCHDOG
        troubles, values = self._told()
        troubles = {
            "waiting for listeners and commands": not self._running and not self.finished.done(),
            "passive, no command": mode == "realtime" and silent and self._running,
            "late ticks": self._late > 0,
            "skipped time": self._skipped > 0,
            "refused commands": self._refused > 0,
            **troubles,
        }
        told = [text for text, holds in troubles.items() if holds]
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
            name=f"{self.get_name()}: {mode}",
            message=", ".join(told) or "running",
            hardware_id=self._name,
        )
        rate, self._reported = (self._tick - self._reported) / REPORT, self._tick
        values = {
            "ticks": self._tick, "rate [Hz]": f"{rate:g}", "late ticks": self._late, "skips of time": self._skipped,
            "late commands": f"{self.late_commands:.4f}", "refused commands": self._refused,
            "unmatched commands": self._unmatched, "repeated samples": self._repeats,
            **values,
        }  # fmt: skip
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)
