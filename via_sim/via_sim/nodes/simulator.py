"""Node `simulator`: one simulated joint that looks like a driver.

ros2 run via_sim simulator --ros-args -p device:=cubic_demo -p mode:=lockstep

publishes   /joint_states       sensor_msgs/JointState, what the device's sensors read at every tick
            /clock              rosgraph_msgs/Clock in modes lockstep and free, before the sample of that time
            /<device>/truth/... StiffnessEstimate, DampingEstimate with method 'truth', if asked (parameter truth)
            /diagnostics        once per second of wall time
subscribes  /<device>/command   via_interfaces/VsaCommand
offers      ~/set_effects, ~/clear_effects, from the next tick on

Time begins when `listeners` subscribers of samples are there, so that nobody misses the first one.

realtime  ticks by the wall clock and catches up when late (counted); without a command for 20 ms the joint is passive
lockstep  ticks exactly when the command with the stamp of the last sample arrives; waits for somebody who commands
free      ticks as fast as it can under the last command

A command that cannot be followed is ignored and counted, and so is one under which the numbers overflow.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.wire import SECOND
from via_interfaces.msg import DampingEstimate, StiffnessEstimate, VsaCommand
from via_interfaces.srv import ClearEffects, SetEffects
from via_ros import qos
from via_ros.conversions import Command, JointStateWriter, command_of, nanoseconds, set_stamp
from via_ros.parameters import declare
from via_ros.spin import STEADY, run

from via_sim.effects import Effect
from via_sim.effects_file import load_effects
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import MAX_SEED, Simulator, passive_command
from via_sim.torques import DAMPING, M1, N_COMMANDS

REPORT = 1.0  # [s] between two diagnostics
WATCHDOG = 20_000_000  # [ns] without a command before a joint in real time goes passive
GIVE_UP = 100_000_000  # [ns] late: time is let go instead of caught up with
LOOK = 0.02  # [s] between two looks whether everybody is there
SETTLED = 5  # looks in a row with everybody there: whoever was found has then found this node too
REPEAT = 100  # looks without an answer before a sample in lockstep is said again
EPOCH = SECOND  # [ns] stamp of the first sample in simulated time; 0 would mean 'no time' to ROS


@dataclass(frozen=True)
class SimulatorParameters:
    """Parameters of the node."""

    device: str = field(default="cubic_demo", metadata={"description": "device name or path to its YAML"})
    mode: str = field(
        default="realtime", metadata={"description": "how time runs", "choices": ("realtime", "lockstep", "free")}
    )
    rate: float = field(default=1000.0, metadata={"description": "ticks", "unit": "Hz", "range": (1.0, 1e5)})
    seed: int = field(default=0, metadata={"description": "seed of the sensor noise", "range": (0, MAX_SEED)})
    effects: str = field(default="", metadata={"description": "effects file; empty: the nominal model"})
    truth: bool = field(default=False, metadata={"description": "publish true stiffness and damping"})
    duration: float = field(
        default=0.0, metadata={"description": "time to simulate; 0: no end", "unit": "s", "range": (0.0, 1e9)}
    )
    listeners: int = field(
        default=1,
        metadata={"description": "subscribers of samples to wait for before time begins", "range": (0, 100)},
    )


class SimulatorNode(Node):
    """The node of this file. `finished` is done when `duration` has been simulated."""

    def __init__(self, **options: Any) -> None:
        super().__init__("simulator", **options)
        self._chosen = own = declare(self, SimulatorParameters)
        self.device = load_device(own.device)
        effects = load_effects(own.effects) if own.effects else ()
        self.finished = Future()
        self._simulator = self._with(effects)
        self._state = self._simulator.init(seed=own.seed)
        self._simulator.step(self._state, np.zeros(N_COMMANDS))  # loads the compiled kernel before anybody waits for it
        self._command = passive_command(self._simulator.plant, self._state)
        self._tick = self._late = self._skipped = self._refused = self._unmatched = self._failures = self._repeats = 0
        self._last = round(own.duration * own.rate) if own.duration > 0.0 else sys.maxsize
        if self._last < 1:
            raise ParameterError(f"parameter duration must be 0 or at least a tick of {1.0 / own.rate:g} s")
        self._heard = -WATCHDOG  # [ns] when the last command came, steady clock
        self._running = False
        self._looks = self._reported = 0
        self._epoch, self._began = EPOCH, 0  # [ns] stamp of sample 0, and steady time of it
        self._samples = JointStateWriter(self.device)
        self._joint_states = self.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self._clock_message = Clock()
        self._clock_publisher = None
        if own.mode != "realtime":
            self._clock_publisher = self.create_publisher(Clock, "/clock", qos.CONTROL)
        self._truths: list[tuple[Any, Any]] = []
        if own.truth:
            self._truths.append(self._offer(StiffnessEstimate, "stiffness"))
            self._truths.append(self._offer(DampingEstimate, "damping"))
        self.create_service(SetEffects, "~/set_effects", self._set_effects)
        self.create_service(ClearEffects, "~/clear_effects", self._clear_effects)
        self._commands = self.create_subscription(VsaCommand, self.device.command_topic, self._take, qos.CONTROL)
        self.create_timer(REPORT, self._report, clock=STEADY)
        self._pace: Any = None
        self.create_timer(LOOK, self._look, clock=STEADY)

    def _offer(self, kind: Any, what: str) -> tuple[Any, Any]:
        message = kind(method="truth")
        message.header.frame_id = self.device.name
        return message, self.create_publisher(kind, f"/{self.device.name}/truth/{what}", qos.SAMPLES)

    def _with(self, effects: Any) -> Simulator:
        """A simulator with these effects; raises ParameterError where one does not fit."""
        plant = JointPlant.from_device(self.device).with_effects(effects)
        return Simulator(plant, self._chosen.rate, Sensors.of_device(self.device))

    # ---- time

    def _after(self, ticks: int) -> int:
        """[ns] that `ticks` take, from sample 0 and without drift."""
        return round(ticks * SECOND / self._chosen.rate)

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
            self._late += behind >= SECOND / self._chosen.rate
            if now - self._heard > WATCHDOG:
                self._command = passive_command(self._simulator.plant, self._state)
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
        elif self._chosen.mode == "lockstep" and self._looks >= REPEAT:
            self._looks = 0
            self._repeats += 1
            self._joint_states.publish(self._samples.stamped(self._stamp()))

    def _everybody_is_there(self) -> bool:
        """Whether those to wait for are there, and everybody known on a topic of ours is connected to us."""
        lockstep = int(self._chosen.mode == "lockstep")
        commanders = max(self.count_publishers(self._commands.topic_name), lockstep)
        listeners = max(self._chosen.listeners, lockstep)
        own = (self._joint_states, *(publisher for _, publisher in self._truths))
        return (
            self._tick < self._last
            and self._joint_states.get_subscription_count() >= listeners
            and self._commands.get_publisher_count() >= commanders
            and all(each.get_subscription_count() >= self.count_subscribers(each.topic_name) for each in own)
        )

    def _begin(self) -> None:
        self._running, self._looks = True, 0
        mode, rate = self._chosen.mode, self._chosen.rate
        if mode == "realtime":
            self._epoch, self._began = self.get_clock().now().nanoseconds, time.monotonic_ns()
            self._pace = self.create_timer(1.0 / rate, self._keep_pace, clock=STEADY)
        elif mode == "free":
            self._pace = self.create_timer(1e-6, self._step, clock=STEADY)
        self._publish(*self._simulator.sample(self._state))

    @property
    def late_ticks(self) -> int:
        """Ticks that began more than one period late, in real time."""
        return self._late

    def _stamp(self) -> int:
        return self._epoch + self._after(self._tick)

    # ---- what comes in

    def _take(self, message: VsaCommand) -> None:
        command = command_of(message, self.device.n_motors)
        row = None if command is None else self._row_of(command)
        if row is None:
            self._refused += 1
            return
        if self._chosen.mode == "lockstep":
            if not self._running or nanoseconds(message.header.stamp) != self._stamp():
                self._unmatched += 1
                return
            self._command = row
            self._step()
            return
        self._command, self._heard = row, time.monotonic_ns()

    def _row_of(self, command: Command) -> Array | None:
        """A command as the kernel's row (4,), or None where this device cannot be commanded so."""
        servo = self.device.drive == "servo"
        row = np.zeros(N_COMMANDS)
        row[DAMPING] = command.damping
        motors = slice(M1, M1 + self.device.n_motors)
        if command.mode == VsaCommand.EQUILIBRIUM_PRESET and (servo or not self.device.n_motors):
            row[motors] = self.device.motor_angles(command.equilibrium, command.preset)
        elif (command.mode == VsaCommand.MOTOR_POSITION and servo) or (
            command.mode == VsaCommand.MOTOR_TORQUE and not servo
        ):
            row[motors] = command.motor
        else:
            return None
        return row

    def _set_effects(self, request: SetEffects.Request, answer: SetEffects.Response) -> SetEffects.Response:
        try:
            self._simulator = self._with([_effect(message) for message in request.effects])
        except ParameterError as error:
            answer.success, answer.message = False, str(error)
            return answer
        answer.success, answer.message = True, self._active()
        return answer

    def _clear_effects(self, _: ClearEffects.Request, answer: ClearEffects.Response) -> ClearEffects.Response:
        self._simulator = self._with(())
        answer.success, answer.message = True, self._active()
        return answer

    def _active(self) -> str:
        effects = self._simulator.plant.effects
        return ", ".join(f"{e.name} at {e.site}{f' {e.motor}' if e.motor else ''}" for e in effects) or "nominal model"

    # ---- what goes out

    def _step(self) -> None:
        if not self._running:
            return
        before = self._state
        self._state, measured, truth = self._simulator.step(before, self._command)
        if not np.isfinite(self._state).all():
            self._failures += 1
            self._command = passive_command(self._simulator.plant, before)
            self._state, measured, truth = self._simulator.step(before, self._command)
            if not np.isfinite(self._state).all():
                self._state = self._simulator.init(seed=self._chosen.seed)
                measured, truth = self._simulator.sample(self._state)
        self._tick += 1
        self._looks = 0
        if self._tick >= self._last:
            self._running = False
            if self._pace is not None:
                self._pace.cancel()
        self._publish(measured, truth)
        if not self._running:
            self.finished.set_result(0)

    def _publish(self, measured: Array, truth: Array) -> None:
        """The sample of this tick; order of the rows: kernel.MEASURED, kernel.TRUTH."""
        stamp, count = self._stamp(), 1 + self.device.n_motors
        if self._clock_publisher is not None:
            set_stamp(self._clock_message.clock, stamp)
            self._clock_publisher.publish(self._clock_message)
        self._samples.position[:] = measured[:count]
        self._samples.velocity[:] = measured[5 : 5 + count]
        self._samples.effort[0] = measured[8]
        self._samples.effort[1:] = measured[3 : 2 + count]
        self._joint_states.publish(self._samples.stamped(stamp))
        for (message, publisher), value in zip(self._truths, (truth[6], truth[9])):
            set_stamp(message.header.stamp, stamp)
            message.sequence = self._tick
            message.value = float(value)
            publisher.publish(message)

    def _report(self) -> None:
        mode, silent = self._chosen.mode, time.monotonic_ns() - self._heard > WATCHDOG
        troubles = {
            "waiting for listeners and commands": not self._running and not self.finished.done(),
            "passive, no command": mode == "realtime" and silent and self._running,
            "late ticks": self._late > 0,
            "skipped time": self._skipped > 0,
            "refused commands": self._refused > 0,
            "numerical failures": self._failures > 0,
        }
        told = [text for text, holds in troubles.items() if holds]
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
            name=f"{self.get_name()}: {mode}",
            message=", ".join(told) or "running",
            hardware_id=self.device.name,
        )
        rate, self._reported = (self._tick - self._reported) / REPORT, self._tick
        values = {
            "ticks": self._tick, "rate [Hz]": f"{rate:g}", "late ticks": self._late, "skips of time": self._skipped,
            "refused commands": self._refused, "unmatched commands": self._unmatched, "repeated samples": self._repeats,
            "numerical failures": self._failures, "effects": self._active(),
        }  # fmt: skip
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)


def _effect(message: Any) -> Effect:
    """An effect from its message; raises ParameterError."""
    names, values = list(message.parameter_names), list(message.parameter_values)
    if len(names) != len(values):
        raise ParameterError(f"{message.name}: {len(names)} parameter names for {len(values)} values")
    return Effect(message.name, message.site, dict(zip(names, values)), int(message.motor), message.joint)


def main() -> int:
    """Run the node."""
    return run(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
