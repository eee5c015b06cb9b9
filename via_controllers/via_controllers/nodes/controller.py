"""The node that all controllers share: lifecycle, samples in, limited torques out, state and diagnostics.

subscribes  /joint_states     sensor_msgs/JointState with all links and motors of the arm or joint
publishes   /<name>/command   via_interfaces/VsaCommand, motor torques with the stamp of the sample they answer
            /<name>/control   via_interfaces/ControlState, internal quantities of the controller, and the limits
            /diagnostics      once per second of wall time

<name> is the name of the arm or the device.

unconfigured  no commands, no torque on the motors
inactive      the arm or joint is held where it was
active        the controller runs

With `autostart` the node configures and activates itself, so that `ros2 run` alone suffices. After 20 ms without a
later stamp, and when it is cleaned up or ended by a signal, the node sends zero torque once; samples whose stamps do
not advance are answered with zero torque. Drivers and simulators have watchdogs in case the node itself is gone. In
lockstep the zero has no effect: its stamp belongs to a sample that is already answered. Diagnostics name a second
commander or a second driver of the robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from via_core.errors import ParameterError, ViaError
from via_interfaces.msg import ControlState, VsaCommand
from via_ros import qos
from via_ros.conversions import JointReader, Joints
from via_ros.gate import Gate, SampleStream
from via_ros.parameters import declare
from via_ros.peers import rivalry
from via_ros.reports import StatusReport, report
from via_ros.serialised import JOINT_STATES, raw
from via_ros.spin import STEADY

from via_controllers.methods import CONTROLLERS
from via_controllers.nodes.answers import AnswerWriter, limit_names
from via_controllers.robot import Controlled, zero_sample
from via_controllers.supervision.arm_supervision import GAP, Change
from via_controllers.supervision.lateness import LATEST, Lateness

REPORT = 1.0  # [s] between two diagnostics
SILENCE = 0.02  # [s] without a later stamp after which torque is zero
STOPPED = "stamps stand still"
LOOK = 0.004  # [s] period of the check for silence
SAME_CLOCK = 1_000_000_000  # [ns] largest age of a stamp from this machine's clock
SLOW = f"samples more than {1e3 * GAP:g} ms apart restart the controller: publish /joint_states at 100 Hz or more"
LATE = (
    f"torques come more than {1e3 * LATEST:g} ms too late and do not act: lower the rate of the samples, or give the "
    "controller a core of its own"
)
WARM_UP = 3  # steps before the first sample, to load compiled functions


# A subscription beside the samples: class of the messages, topic, callback, quality of service.
Input = tuple[Any, str, Callable[[Any], None], Any]
Connect = Callable[[Any], tuple[Controlled, tuple[Input, ...]]]


class ControllerNode(LifecycleNode):
    """A controller of an arm or a joint.

    name     of the node and, in CONTROLLERS, of its controller
    connect  makes the robot and further inputs from the parameters; by default `build`, without inputs
    """

    def __init__(
        self, name: str, connect: Connect = lambda parameters: (parameters.build(), ()), **options: Any
    ) -> None:
        super().__init__(name, **options)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._checked_change_state
        self._settings = declare(self, CONTROLLERS[name], changed=self._tune)
        self._connect = connect
        self._active = False
        self._supervisor: Any = None
        self._entities: list[tuple[Callable[[Any], Any], Any]] = []  # created on configuration, with their destructors
        if self._settings.autostart:
            self._set_up()  # raises errors that the transitions below would only log
            self._tear_down()
            self.trigger_configure()
            self.trigger_activate()

    # ---- lifecycle

    def _checked_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse an invalid transition; rclpy would raise an error that ends the executor."""
        _, state = self._state_machine.current_state
        try:
            return self._change_state(request, response)
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
        self._end()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        self._end()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self.on_shutdown(state)

    def close(self, _failed: bool) -> None:
        """The process ends, by a signal or by an error."""
        self._end()

    def _tune(self, settings: Any) -> Callable[[], None]:
        """Returns what continues with changed parameters, from the present state."""
        tuned = settings.tuned(self._supervisor) if self._entities else None

        def put_into_effect() -> None:
            self._settings = settings
            if tuned is not None:
                self._supervisor = tuned

        return put_into_effect

    def _set_up(self) -> None:
        self._robot, inputs = self._connect(self._settings)
        self._supervisor = self._settings.tuned(self._robot.supervisor)
        self._state = self._supervisor.init()
        _warm_up(self._robot)
        self._writer = AnswerWriter(self._robot, self.get_name())
        self._answered = self._unusable = self._reported = self._silences = self._stopped = 0
        self._faults: dict[str, bool] = {}  # since the last report
        self._gate = Gate(self.get_logger())
        self._status = StatusReport(self, self._robot.name)
        self._last_report = time.monotonic()  # [s]
        self._limited = self._gaps = self._late = 0  # since the last report: bits of Limit, and numbers
        self._warned = False  # of the present gaps
        self._time = np.inf  # [s] of the last usable sample
        self._progress: float | None = None  # [s] steady clock at the last later stamp
        self._silent = True  # the present silence is handled already
        self._lateness = Lateness()
        self._last: int | None = None  # [ns] stamp of the last sample
        publisher = self._creator(self.create_publisher, self.destroy_publisher)
        self._publish_command = raw(publisher(VsaCommand, self._robot.command_name, qos.SAMPLES))
        self._publish_state = raw(publisher(ControlState, f"{self._robot.name}/control", qos.SAMPLES))
        self._reports = publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        timer = self._creator(self.create_timer, self.destroy_timer)
        timer(REPORT, self._report, clock=STEADY)
        timer(LOOK, self._look, clock=STEADY)
        subscription = self._creator(self.create_subscription, self.destroy_subscription)
        for kind, topic, callback, profile in inputs:
            subscription(kind, topic, self._gate.message(callback), profile)
        joints, entries, self._required = self._robot.reading
        self._samples = SampleStream(self, JOINT_STATES, JointReader([(joints, entries)]), self._answer, qos.LOOP)
        self._entities.append((SampleStream.destroy, self._samples))
        if missing := self._supervisor.limits.unstated:
            self.get_logger().warning(f"{self._robot.name}: its file states no {missing}: not limited")

    def _creator(self, create: Callable[..., Any], destroy: Callable[[Any], Any]) -> Callable[..., Any]:
        def created(*args: Any, **options: Any) -> Any:
            self._entities.append((destroy, create(*args, **options)))
            return self._entities[-1][1]

        return created

    def _end(self) -> None:
        """The last command is zero: the torque does not wait for the driver's watchdog to end."""
        if self._entities and self._last is not None:
            self._send_zero(self._last)
        self._tear_down()

    def _send_zero(self, last: int) -> None:
        zero = np.zeros(self._supervisor.limits.arm.n)
        self._publish_command(self._writer.command(_stamp_now(last), zero))

    def _tear_down(self) -> None:
        while self._entities:
            destroy, entity = self._entities.pop()
            destroy(entity)

    # ---- samples

    @property
    def answered(self) -> int:
        """Number of samples answered since configuration."""
        return self._answered

    def time_of(self, stamp: Any) -> float:
        """[s] of a message's stamp in the time of samples; NaN before the first sample."""
        return self._samples.time_of(stamp)

    def update(self, change: Change) -> None:
        """Apply `change` to the controller's state if the controller is active."""
        self._state = self._supervisor.updated(self._state, change)

    def _answer(self, joints: Joints, rows: list[int]) -> None:
        if not (rows and self._entities):  # without: the sample was received before its subscription was destroyed
            return
        stamp, now = joints.stamp, time.monotonic()
        sample = self._robot.sample(self._samples.reader.rows[0][0])
        if self._last is None or stamp > self._last:
            self._progress, self._silent = now, False
        self._last = stamp
        if self._progress is not None and now - self._progress > SILENCE:
            self._stopped += 1
            answer = self._supervisor.passive()
        else:
            acts = self._acts(stamp, now)
            self._late += not acts
            self._state, answer = self._supervisor.step(self._state, sample, self._active, acts)
        self._publish_command(self._writer.command(stamp, answer.torque))
        self._answered += 1
        if answer.fault:
            self._faults[answer.fault] = True
        if answer.unusable:
            self._unusable += 1
        else:
            self._gaps += sample.time - self._time > GAP
            self._time = sample.time
        self._limited |= int(answer.limited)
        if self._answered % self._settings.told_every == 0:
            values = self._supervisor.observe(self._state)
            self._publish_state(self._writer.state(stamp, answer, values))

    def _acts(self, stamp: int, now: float) -> bool:
        """Whether the torque for a sample with this stamp [ns] will act."""
        if not _is_present(stamp):  # simulated time has its own pace
            return True
        self._lateness, acts = self._lateness.step(1e-9 * stamp, now)
        return acts

    def _look(self) -> None:
        """Send zero torque once when stamps stop: the last torque then no longer fits the motion."""
        if not self._entities or self._silent or self._progress is None or self._last is None:
            return
        if time.monotonic() - self._progress > SILENCE - LOOK:
            self._silent = True
            self._silences += 1
            self._send_zero(self._last)

    def _report(self) -> None:
        if not self._entities:  # the timer was due already when its publisher was destroyed
            return
        malformed, silent = self._samples.malformed(), self._answered == self._reported
        rivals, peers = rivalry(self, JOINT_STATES, self._robot.command_name)
        state, now = "active" if self._active else "holding still", time.monotonic()
        rate = (self._answered - self._reported) / max(now - self._last_report, LOOK)
        self._reported, self._last_report = self._answered, now
        conditions = {
            **self._samples.conditions(silent, required=self._required),
            SLOW: self._gaps > 0,
            STOPPED: self._stopped > 0,
            LATE: self._late > 0,
            **self._faults,
            **rivals,
            "at a limit": self._limited != 0,
        }
        events = {
            "malformed messages": malformed,
            f"refused messages: {self._gate.reason}": self._gate.refused,
        }
        values = {
            "state": state, "samples": self._answered, "rate [Hz]": f"{rate:g}", "unusable samples": self._unusable,
            "malformed messages": malformed, "refused messages": self._gate.refused, "gaps": self._gaps,
            "late torques": self._late, "silences": self._silences, "samples with an old stamp": self._stopped,
            **peers, "limits": limit_names(self._limited), **self._writer.limits,
        }  # fmt: skip
        if self._gaps and not self._warned:
            self.get_logger().warning(SLOW)
        self._limited, self._gaps, self._late, self._warned = 0, 0, 0, self._gaps > 0
        self._stopped, self._faults = 0, {}
        report(self, self._reports, [self._status.status(conditions, events, values, state)])


def _stamp_now(last: int) -> int:
    """Time now [ns] if stamps are from this machine's clock, else the `last` stamp.

    Simulated time may stop between two samples: commands stamped later than simulated time would come after the next
    ones, which logs then drop.
    """
    return time.time_ns() if _is_present(last) else last


def _is_present(stamp: int) -> bool:
    """Whether a stamp [ns] is from this machine's clock, or one near it."""
    return bool(0 <= time.time_ns() - stamp <= SAME_CLOCK)


def _warm_up(robot: Controlled) -> None:
    """Load compiled functions; raises ParameterError where the controller does not fit the robot's motors."""
    supervisor: Any = robot.supervisor
    n = supervisor.limits.arm.n
    for active in (False, True):
        state = supervisor.init()
        for step in range(WARM_UP):
            state, answer = supervisor.step(state, zero_sample(robot, 1e-3 * step), active)
            if len(answer.torque) != n:
                raise ParameterError(f"the controller returns {len(answer.torque)} torques for {n} motors")
