"""Base of all simulator nodes: modes of time, which command acts and how long, and diagnostics.

publishes   /joint_states    sensor_msgs/JointState at every tick
            /clock           rosgraph_msgs/Clock in modes lockstep and free, before the sample of that time
            /diagnostics     once per second of wall time
subscribes  /<name>/command  via_interfaces/VsaCommand

Time begins when the samples have `listeners` subscribers, so that none of them misses the first sample.

realtime  ticks with the wall clock and catches up when late (late ticks are counted); a command acts for 20 ms after
          the sample that it answers, or after its arrival if its stamp belongs to no sample; afterwards no drive acts
lockstep  ticks when a command with the stamp of the last sample arrives; waits for a publisher of commands
free      ticks as fast as possible under the last command

Commands that do not fit the robot, and commands that make the state overflow, are ignored and counted. While two nodes
command the robot, all commands are refused. A simulator does not begin while another node publishes samples of its
joints, stops again if it receives one of them soon after (discovery takes time), and refuses all commands if one begins
later. Diagnostics name these nodes.
"""

from __future__ import annotations

import sys
import time
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from via_core.errors import ParameterError
from via_core.parameters import parameter
from via_core.wire import SECOND
from via_interfaces.msg import VsaCommand
from via_ros import qos
from via_ros.conversions import Command, set_stamp
from via_ros.gate import Gate, RenewedSubscription
from via_ros.peers import CommandOrigin, DriverOrigin, rivalry
from via_ros.reports import StatusReport, report
from via_ros.serialised import JOINT_STATES, JointStateBytes, decoded_command, raw
from via_ros.spin import STEADY

from via_sim.nodes.round_trips import RoundTrips

Row = TypeVar("Row")  # a command as the simulated robot takes it

REPORT = 1.0  # [s] between diagnostics
WATCHDOG = 20_000_000  # [ns] for which a command acts in mode realtime
MAX_LATE = 100_000_000  # [ns] beyond it time is skipped instead of caught up
POLL = 0.02  # [s] between checks of the connections
STABLE = 5  # successive checks with all connections, so that discovery is complete on both sides
REPEAT = 100  # checks without an answer before lockstep publishes a sample again
YOUNG = 2.0  # [s] after its begin during which a simulator gives way to another one
LONGEST = 1e9  # [s]
EPOCH = SECOND  # [ns] stamp of the first sample in simulated time; in ROS a stamp of 0 means 'no time'


@dataclass(frozen=True)
class TimeParameters:
    """Parameters of every simulator node."""

    mode: str = parameter("realtime", "mode of time", choices=("realtime", "lockstep", "free"))
    rate: float = parameter(1000.0, "tick rate", "Hz", (1.0, 1e5))
    duration: float = parameter(0.0, "simulated time; 0: no end", "s", (0.0, LONGEST))
    listeners: int = parameter(1, "number of subscribers of samples to wait for before time begins", "", (0, 100))


class SimulationNode(Node, Generic[Row]):
    """A robot in simulated time; the future `finished` is done when `duration` has been simulated.

    A subclass implements the robot and calls `start_listening` at the end of its constructor.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.finished = Future()
        self.gate = Gate(self.get_logger())
        self.round_trips = RoundTrips()
        self._tick = self._late = self._skipped = self._refused = self._unmatched = self._repeats = 0
        self._taken = self._overtaken = self._looks = self._mixed = 0
        self._last = sys.maxsize
        self._running, self._since = False, 0.0  # [s] steady clock when time began
        self._polls = self._reported = 0
        self._epoch, self._began = EPOCH, 0  # [ns] stamp and steady time of sample 0
        self._joint_states = self.create_publisher(JointState, JOINT_STATES, qos.SAMPLES)
        self._publish_sample = raw(self._joint_states)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self._clock_message = ClockMessage()
        self._clock_publisher: Any = None
        self._pace: Any = None
        self._beside: list[Any] = []  # publishers of further topics of every sample

    def start_listening(self, times: TimeParameters, name: str, command_name: str) -> None:
        """Accept commands, and begin when all connections are there. `name` is that of the device or arm."""
        self._times, self._name, self._status = times, name, StatusReport(self, name)
        if times.duration > 0.0:
            self._last = round(times.duration * times.rate)
        if self._last < 1:
            raise ParameterError(f"parameter duration must be 0 or at least a tick of {1.0 / times.rate:g} s")
        self._command = self._passive()
        self._command_stamp = -WATCHDOG  # [ns] stamp from which the command's time counts
        if times.mode != "realtime":
            self._clock_publisher = self.create_publisher(ClockMessage, "/clock", qos.CONTROL)
        self._commands = RenewedSubscription(self, VsaCommand, command_name, self._take, qos.LOOP)
        self._commanders = CommandOrigin()
        self._serialised = JointStateBytes(self._samples)
        topics = self._joint_states.topic_name, self._commands.topic_name
        self._drivers = DriverOrigin(self, *topics, self._samples.names)
        self.create_timer(REPORT, self._report, clock=STEADY)
        self.create_timer(POLL, self._poll, clock=STEADY)
        needs = str(max(times.listeners, int(times.mode == "lockstep")))
        needs += ", and a publisher of commands" if times.mode == "lockstep" else ""
        self.get_logger().info(
            f"simulates {name} at {times.rate:g} Hz, {times.mode}: publishes {topics[0]}, takes "
            f"{topics[1]}; subscribers needed to start: {needs}"
        )

    # ---- the robot

    _samples: Any  # StateWriter of the robot

    @abstractmethod
    def _passive(self) -> Row:
        """The command under which no drive acts in the present state."""

    @abstractmethod
    def _row_of(self, command: Command) -> Row | None:
        """The command as the robot takes it; None if it does not fit the robot."""

    @abstractmethod
    def _advance(self, command: Row) -> None:
        """Simulate one tick under a command."""

    @abstractmethod
    def _sample(self, stamp: int) -> None:
        """Write the present measurements into `_samples`; publish the further topics with this stamp [ns]."""

    @abstractmethod
    def _diagnose(self) -> tuple[dict[str, int], dict[str, Any]]:
        """Numbers of events to warn of, and values for the diagnostics."""

    # ---- time

    def _after(self, ticks: int) -> int:
        """Time [ns] of tick `ticks` after sample 0, without accumulated rounding."""
        return round(ticks * SECOND / self._times.rate)

    def _keep_pace(self) -> None:
        """Take all ticks that are due, in mode realtime."""
        if not self._running:  # the timer was due already when time stopped
            return
        now = time.monotonic_ns()
        behind = now - self._began - self._after(self._tick + 1)
        if behind > MAX_LATE:
            self._skipped += 1
            self._began += behind
            self._epoch += behind
            behind = 0
        while behind >= 0 and self._running:
            self._late += behind >= SECOND / self._times.rate
            # The command must be valid until the end of the tick.
            if self._epoch + self._after(self._tick + 1) - self._command_stamp > WATCHDOG:
                self._command = self._passive()
            self._step()
            behind = now - self._began - self._after(self._tick + 1)

    def _poll(self) -> None:
        """Begin when all connections are there; in lockstep publish an unanswered sample again."""
        self._polls += 1
        self._looks += 1
        if not self._running or self._looks % STABLE == 0:
            self._drivers.look()
        if not self._running:
            if not (self._is_connected() and self._drivers.is_alone()):
                self._polls = 0
            elif self._polls >= STABLE:
                self._begin()
        elif self._drivers.is_mixed() and time.monotonic() - self._since < YOUNG:
            self._give_way()
        elif self._times.mode == "lockstep" and self._polls >= REPEAT:
            self._polls = 0
            self._repeats += 1
            self._publish_sample(self._last_sample)

    def _is_connected(self) -> bool:
        """Whether the required listeners are there and every known peer of our topics is connected."""
        lockstep = int(self._times.mode == "lockstep")
        commanders = max(self.count_publishers(self._commands.topic_name), lockstep)
        listeners = max(self._times.listeners, lockstep)
        own = (self._joint_states, *self._beside)
        return (
            self._tick < self._last
            and self._joint_states.get_subscription_count() >= listeners + self._drivers.listens
            and self._commands.get_publisher_count() >= commanders
            and all(each.get_subscription_count() >= self.count_subscribers(each.topic_name) for each in own)
        )

    def _give_way(self) -> None:
        """Stop time until the other driver has gone."""
        self._running, self._polls = False, 0
        if self._pace is not None:
            self.destroy_timer(self._pace)
            self._pace = None
        self.get_logger().warning(f"another node publishes samples of {self._name}: waits until it has gone")

    def _begin(self) -> None:
        self._running, self._polls, self._since = True, 0, time.monotonic()
        mode, rate = self._times.mode, self._times.rate
        # A clock of its own: this timer may always be ready, and each other timer of its clock that is made, reset or
        # ready meanwhile makes EventsExecutor (rclpy 7.1) put it twice into its queue; all other callbacks then starve.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        if mode == "realtime":
            passed = self._after(self._tick)  # not 0 if time was stopped
            self._epoch, self._began = self.get_clock().now().nanoseconds - passed, time.monotonic_ns() - passed
            self._pace = self.create_timer(1.0 / rate, self._keep_pace, clock=clock)
        elif mode == "free":
            self._pace = self.create_timer(1e-6, self._step, clock=clock)
        self.get_logger().info(f"started: {self._name} publishes")
        self._publish()

    @property
    def ticks(self) -> int:
        """Number of ticks since time began."""
        return self._tick

    @property
    def late_ticks(self) -> int:
        """Number of ticks that began more than one period late, in mode realtime."""
        return self._late

    @property
    def late_commands(self) -> float:
        """Share of commands that arrived after the sample following theirs; not in lockstep."""
        return self._overtaken / max(self._taken, 1)

    def _stamp(self) -> int:
        return self._epoch + self._after(self._tick)

    def _step(self) -> None:
        if not self._running:
            return
        self._advance(self._command)
        self._tick += 1
        self._polls = 0
        if self._tick >= self._last:
            self._running = False
            if self._pace is not None:
                self._pace.cancel()
        self._publish()
        if not self._running:
            self.finished.set_result(0)

    def _publish(self) -> None:
        """Publish the sample of this tick."""
        stamp = self._stamp()
        if self._clock_publisher is not None:
            set_stamp(self._clock_message.clock, stamp)
            self._clock_publisher.publish(self._clock_message)
        self._sample(stamp)
        self._last_sample = self._serialised.stamped(stamp)
        self._drivers.sent(stamp)
        self.round_trips.sent(stamp)
        self._publish_sample(self._last_sample)

    # ---- commands

    def _take(self, data: bytes) -> None:
        decoded = decoded_command(data)
        row = None if decoded is None else self._row_of(decoded[1])
        if decoded is None or row is None:
            self._refused += 1
            return
        if (self._commanders.is_mixed(data) and self._commands.get_publisher_count() > 1) or self._drivers.is_mixed():
            self._mixed += 1
            self._command = self._passive()
            return
        now, stamp = self._stamp(), decoded[0]
        self.round_trips.answered(stamp)
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
        self._command, self._command_stamp = row, stamp if known else now

    # ---- diagnostics

    def _report(self) -> None:
        trips, mode, silent = self.round_trips, self._times.mode, self._stamp() - self._command_stamp > WATCHDOG
        events, values = self._diagnose()
        rivals, peers = rivalry(self, self._joint_states.topic_name, self._commands.topic_name)
        conditions = {
            **rivals,
            "waiting for listeners and commands": not self._running and not self.finished.done(),
            "passive, no command": mode == "realtime" and silent and self._running,
        }
        events = {
            f"refused requests: {self.gate.reason}": self.gate.refused,
            "late ticks": self._late,
            "skipped time": self._skipped,
            "refused commands": self._refused,
            **events,
        }
        rate, self._reported = (self._tick - self._reported) / REPORT, self._tick
        values = {
            "mode": mode, "ticks": self._tick, "rate [Hz]": f"{rate:g}", "late ticks": self._late,
            "skips of time": self._skipped,
            "late commands": f"{self.late_commands:.4f}", "refused commands": self._refused,
            "round trip, median [ms]": f"{trips.percentile(50.0):.3f}",
            "round trip, 99 % [ms]": f"{trips.percentile(99.0):.3f}",
            "round trip, largest [ms]": f"{trips.largest:.3f}",
            "commands refused for a second commander or driver": self._mixed,
            **peers, "unmatched commands": self._unmatched, "repeated samples": self._repeats,
            **values,
        }  # fmt: skip
        report(self, self._reports, [self._status.status(conditions, events, values, "running")])
