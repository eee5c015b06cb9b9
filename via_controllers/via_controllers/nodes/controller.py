"""What every node of a law shares: its lifecycle, samples in, limited torques out, and what is told.

subscribes  /joint_states     sensor_msgs/JointState with all links and motors of the arm, or of the joint
publishes   /<name>/command   via_interfaces/VsaCommand, motor torques, stamped with the sample they answer
            /<name>/control   via_interfaces/ControlState, what the law sees, and the limits
            /diagnostics      once per second of wall time

<name> is that of the arm or the device.

unconfigured  silent: nothing drives the motors
inactive      holds arm or joint still where it was
active        the law decides

With `autostart` the node configures and activates itself, so that `ros2 run` alone does. Samples that are missing for
20 ms are answered with zero torque, once; drivers and simulators have a watchdog of their own for when it is gone.
In lockstep that zero changes nothing: it bears a stamp that is answered already.
A new node is a dataclass of parameters and a function that makes a law of them: see `modal_limit_cycle`.
"""

from __future__ import annotations

import array
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from via_core.errors import ParameterError, ViaError
from via_core.signals import Array
from via_interfaces.msg import ControlState, VsaCommand
from via_ros import qos
from via_ros.conversions import Command, set_stamp
from via_ros.parameters import declare
from via_ros.serialised import CommandBytes, JointStateDecoder
from via_ros.spin import STEADY

from via_controllers.arm_limits import Limit
from via_controllers.nodes.equipment import Equipment, StartParameters
from via_controllers.supervision import GAP, Activity, Answer, Change

REPORT = 1.0  # [s] between two diagnostics
SILENCE = 0.02  # [s] without a sample before a zero is sent
LOOK = 0.004  # [s] between two looks for it
SAME_CLOCK = 1_000_000_000  # [ns] after a sample's stamp at most that it is missed, by the clock that stamped it
SLOW = f"samples more than {1e3 * GAP:g} ms apart, the law starts anew at each: publish /joint_states at 100 Hz or more"
WARM_UP = 3  # steps before anybody waits for one: what is compiled is loaded


Parameters = TypeVar("Parameters", bound=StartParameters)


class ControllerNode(LifecycleNode):
    """A law of an arm or a joint in ROS.

    name   of the node, and `method` of what it tells
    kind   the dataclass of its parameters
    make   what such parameters mean; raises ParameterError
    """

    def __init__(
        self,
        name: str,
        kind: type[Parameters],
        make: Callable[[Parameters], Equipment],
        **options: Any,
    ) -> None:
        super().__init__(name, **options)
        self._change = self._service_change_state.callback
        self._service_change_state.callback = self._changed
        self._chosen = declare(self, kind)
        self._make: Callable[[Any], Equipment] = make
        self._active = False
        self._entities: list[tuple[Callable[[Any], Any], Any]] = []  # how to destroy what configuring made
        if self._chosen.autostart:
            self._set_up()  # raises what is wrong, in one line
            self._tear_down()
            self.trigger_configure()
            self.trigger_activate()

    # ---- lifecycle

    def _changed(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """A transition that the state does not allow is refused; rclpy would raise it out of the executor."""
        _, state = self._state_machine.current_state
        try:
            return self._change(request, response)
        except rclpy_implementation.RCLError:
            self.get_logger().error(f"no transition {request.transition.id} from '{state}'")
            response.success = False
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._set_up()
        except ViaError as error:
            self.get_logger().error(str(error))
            self._tear_down()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._tear_down()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        self._tear_down()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self.on_shutdown(state)

    def _set_up(self) -> None:
        equipment = self._make(self._chosen)
        self._equipment, self._supervisor = equipment, equipment.supervisor
        self._state = self._supervisor.init()
        _warm_up(equipment)
        self._writer = CommandBytes(equipment)
        self._told = _Told(equipment, self.get_name())
        self._decoder = JointStateDecoder()
        self._answered = self._unusable = self._reported = self._silences = self._broken = 0
        self._limited, self._gaps = Limit.NONE, 0  # since the last report
        self._warned = False  # of the gaps that there are
        self._time = np.inf  # [s] of the last usable sample
        self._heard: float | None = None  # [s] steady clock; None: nothing to miss
        self._last = 0  # [ns] stamp of the last sample
        self._commands = self._made(self.create_publisher, self.destroy_publisher)(
            VsaCommand, equipment.command_topic, qos.CONTROL
        )
        self._states = self._made(self.create_publisher, self.destroy_publisher)(
            ControlState, f"/{equipment.name}/control", qos.SAMPLES
        )
        self._reports = self._made(self.create_publisher, self.destroy_publisher)(
            DiagnosticArray, "/diagnostics", qos.CONTROL
        )
        timer = self._made(self.create_timer, self.destroy_timer)
        timer(REPORT, self._report, clock=STEADY)
        timer(LOOK, self._look, clock=STEADY)
        subscription = self._made(self.create_subscription, self.destroy_subscription)
        for each in equipment.inputs:
            subscription(each.kind, each.topic, each.heard, each.qos)
        subscription(JointState, "/joint_states", self._answer, qos.CONTROL, raw=True)

    def _made(self, create: Callable[..., Any], destroy: Callable[[Any], Any]) -> Callable[..., Any]:
        def made(*args: Any, **options: Any) -> Any:
            self._entities.append((destroy, create(*args, **options)))
            return self._entities[-1][1]

        return made

    def _tear_down(self) -> None:
        while self._entities:
            destroy, entity = self._entities.pop()
            destroy(entity)

    # ---- samples

    @property
    def answered(self) -> int:
        """Samples answered since it was configured."""
        return self._answered

    def _answer(self, data: bytes) -> None:
        joints = self._decoder.decode(data)
        if joints is None:
            self._broken += 1
            return
        heard = self._equipment.ears.heard(joints)
        if heard is None:
            return
        stamp, sample = heard
        self._state, answer = self._supervisor.step(self._state, sample, self._active)
        self._send(stamp, answer.torque)
        self._heard, self._last = time.monotonic(), stamp
        self._answered += 1
        if answer.activity is Activity.PASSIVE:
            self._unusable += 1
        else:
            self._gaps += sample.time - self._time > GAP
            self._time = sample.time
        self._limited |= answer.limited
        if self._answered % self._chosen.told_every == 0:
            self._states.publish(self._told.at(stamp, answer, self._supervisor.told(self._state)))

    def inform(self, change: Change) -> None:
        """Tell the law something that no sample says, where it decides."""
        self._state = self._supervisor.informed(self._state, change)

    def _send(self, stamp: int, torque: Array) -> None:
        command = Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, self._equipment.damping, torque)
        self._commands.publish(self._writer.numbered(stamp, command))

    def _look(self) -> None:
        """Nobody tells where the arm is: whatever it was told last is no good any more."""
        if self._heard is not None and time.monotonic() - self._heard > SILENCE - LOOK:
            self._heard = None
            self._silences += 1
            self._send(_stamp_now(self._last), np.zeros(self._supervisor.limits.arm.n))

    def _report(self) -> None:
        if not self._entities:  # a timer that was due already when what it speaks through was given back
            return
        malformed, silent = self._broken + self._equipment.ears.malformed, self._answered == self._reported
        rate, self._reported = (self._answered - self._reported) / REPORT, self._answered
        troubles = {
            "no samples": silent,
            SLOW: self._gaps > 0,
            "unusable samples": self._unusable > 0,
            "malformed messages": malformed > 0,
            "at a limit": self._limited != Limit.NONE,
        }
        told = [text for text, holds in troubles.items() if holds]
        values = {
            "samples": self._answered, "rate [Hz]": f"{rate:g}", "unusable samples": self._unusable,
            "malformed messages": malformed, "gaps": self._gaps, "silences": self._silences,
            "limits": _names(self._limited), **self._told.limits,
        }  # fmt: skip
        if self._gaps and not self._warned:
            self.get_logger().warning(SLOW)
        self._limited, self._gaps, self._warned = Limit.NONE, 0, self._gaps > 0
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
            name=f"{self.get_name()}: {'active' if self._active else 'holding still'}",
            message=", ".join(told) or "running",
            hardware_id=self._equipment.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)


class _Told:
    """One reused ControlState of a law, numbered from 0."""

    def __init__(self, equipment: Equipment, method: str) -> None:
        arm, law = equipment.supervisor.limits.arm, equipment.supervisor.law
        limits = {
            "torque_limit": arm.torque_limit,
            "speed_limit": arm.speed_limit,
            "deflection_limit": arm.deflection_limit,
        }
        self.limits = {name: " ".join(f"{value:g}" for value in values) for name, values in limits.items()}
        self._message = ControlState(
            method=method,
            name=[each.name for each in law.quantities],
            unit=[each.unit for each in law.quantities],
            value=array.array("d", [np.nan] * len(law.quantities)),
            **{name: array.array("d", values) for name, values in limits.items()},
        )
        self._message.header.frame_id = equipment.name
        self._value: Array = np.frombuffer(self._message.value)
        self._sequence = 0

    def at(self, stamp: int, answer: Answer, told: Array) -> ControlState:
        """The message about the sample of this stamp [ns]."""
        message = self._message
        set_stamp(message.header.stamp, stamp)
        message.sequence, self._sequence = self._sequence, self._sequence + 1
        message.activity, message.limited = int(answer.activity), int(answer.limited)
        self._value[:] = told
        return message


def _stamp_now(last: int) -> int:
    """[ns] now, if samples bear this machine's time; else the stamp of the `last` one.

    Simulated time may stand still between two samples: whatever is later is then too late for the commands to come,
    which logs drop behind it.
    """
    now = time.time_ns()
    return now if 0 <= now - last <= SAME_CLOCK else last


def _names(limits: Limit) -> str:
    return ", ".join(each.name.lower() for each in Limit if each and each in limits and each.name) or "none"


def _warm_up(equipment: Equipment) -> None:
    """Raises ParameterError where a law cannot live with what it is to control."""
    supervisor, n = equipment.supervisor, equipment.supervisor.limits.arm.n
    for active in (False, True):
        state = supervisor.init()
        for step in range(WARM_UP):
            state, answer = supervisor.step(state, equipment.still(1e-3 * step), active)
            if len(answer.torque) != n:
                raise ParameterError(f"the law answers {len(answer.torque)} torques to {n} motors")
