"""The same loop in the plain way of rclpy: message objects, ordinary callbacks, default executor and queues.

The numerical work is the same: the compiled steps of simulator, estimators, controller and limits.
"""

from __future__ import annotations

import re
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from via_controllers.contract import JointSample
from via_controllers.joint_methods import ExcitationParameters
from via_controllers.robot import zero_sample
from via_core.devices import load_device
from via_core.wire import SECOND
from via_estimators.contract import Live
from via_estimators.methods import estimator_for
from via_interfaces.msg import ControlState, MotorEstimate, StiffnessEstimate, VsaCommand
from via_sim.joint.layout import DAMPING, M1, N_COMMANDS
from via_sim.joint.measurements import MEASURED
from via_sim.nodes.round_trips import RoundTrips
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

from via_validation.bench.realtime.loop import DEVICE, LISTENERS, METHODS, RATE, Part, simulated

DEPTH = 10  # of every queue, as in the tutorials


class PlainSimulator(Node):
    """A joint: a timer that steps and publishes, a subscription that keeps the last command."""

    def __init__(self, seconds: float) -> None:
        super().__init__("simulator")
        self.device = load_device(DEVICE)
        self.finished, self.round_trips = Future(), RoundTrips()
        self.simulator = Simulator(JointPlant.from_device(self.device), RATE, Sensors.of_device(self.device))
        self.state, self.command = self.simulator.init(seed=0), np.zeros(N_COMMANDS)
        self.simulator.step(self.state, self.command)  # compiles
        self.seconds, self.ticks, self.due, self.began = seconds, 0, 0, 0.0
        self.publisher = self.create_publisher(JointState, "/joint_states", DEPTH)
        self.heard = self.create_subscription(VsaCommand, self.device.command_topic, self.take, DEPTH)
        self.timer = self.create_timer(1.0 / RATE, self.tick)

    def tick(self) -> None:
        """One step and its sample."""
        now = time.monotonic()
        if not self.began:
            if self.publisher.get_subscription_count() < LISTENERS or self.heard.get_publisher_count() < 1:
                return
            self.began = now
        self.ticks += 1
        self.due = round((now - self.began) * RATE) + 1  # a timer of rcl leaves late ticks out
        self.state, measured, _ = self.simulator.step(self.state, self.command)
        count = 1 + self.device.n_motors
        message = JointState()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self.device.name
        message.name = [self.device.link_joint, *self.device.motor_joints]
        message.position = measured[:count].tolist()
        message.velocity = measured[MEASURED.q_velocity : MEASURED.q_velocity + count].tolist()
        message.effort = [measured[MEASURED.tau_link], *measured[MEASURED.tau_1 : MEASURED.tau_1 + count - 1]]
        self.round_trips.sent(_nanoseconds(message))
        self.publisher.publish(message)
        if now - self.began >= self.seconds:
            self.timer.cancel()
            self.finished.set_result(0)

    def take(self, message: VsaCommand) -> None:
        """Keep a command for the next step."""
        self.round_trips.answered(_nanoseconds(message))
        self.command = np.zeros(N_COMMANDS)
        self.command[DAMPING] = message.damping
        self.command[M1 : M1 + self.device.n_motors] = message.motor


class PlainEstimator(Node):
    """One method: a subscription that estimates and publishes."""

    def __init__(self, number: int) -> None:
        super().__init__(f"estimator_{number}")
        self.device, self.method = load_device(DEVICE), METHODS[number]
        self.estimator = estimator_for(self.device, self.method)
        self.live, self.samples, self.origin = Live(self.estimator), 0, 0
        self.live.take(np.full((1, 1 + len(self.estimator.inputs)), np.nan))  # compiles
        self.live.restart()
        self.estimator.load()
        topic = f"/{self.device.name}/{self.method}"
        self.stiffness = self.create_publisher(StiffnessEstimate, f"{topic}/stiffness", DEPTH)
        self.motor: Any = None
        if any(output.startswith("motor") for output in self.estimator.outputs):
            self.motor = self.create_publisher(MotorEstimate, f"{topic}/motor", DEPTH)
        self.create_subscription(JointState, "/joint_states", self.take, DEPTH)

    def take(self, message: JointState) -> None:
        """Estimate from one sample."""
        stamp = _nanoseconds(message)
        self.origin = self.origin or stamp
        row = [(stamp - self.origin) / SECOND]
        for name in self.estimator.inputs:
            motor = re.search(r"_(\d+)$", name)
            joint = self.device.motor_joints[int(motor[1]) - 1] if motor else self.device.link_joint
            values = message.effort if name.startswith("tau") else message.position
            row.append(values[message.name.index(joint)])
        status = self.live.take(np.array([row]))
        outputs = self.estimator.outputs
        value = dict(zip(outputs, self.live.value.tolist(), strict=True))
        error = dict(zip(outputs, self.live.standard_deviation.tolist(), strict=True))

        def of(start: str, numbers: dict[str, float]) -> list[float]:
            return [numbers[name] for name in outputs if re.fullmatch(rf"{start}_\d+", name)]

        estimate = StiffnessEstimate(header=message.header, sequence=self.samples, status=status, method=self.method)
        estimate.value, estimate.standard_deviation = value["stiffness"], error["stiffness"]
        estimate.transmission_value = of("stiffness", value)
        estimate.transmission_standard_deviation = of("stiffness", error)
        self.stiffness.publish(estimate)
        if self.motor is not None:
            motors = MotorEstimate(header=message.header, sequence=self.samples, status=status, method=self.method)
            motors.inertia, motors.inertia_standard_deviation = (
                of("motor_inertia", value),
                of("motor_inertia", error),
            )
            motors.damping, motors.damping_standard_deviation = (
                of("motor_damping", value),
                of("motor_damping", error),
            )
            self.motor.publish(motors)
        self.samples += 1


class PlainController(Node):
    """A subscription that answers each sample with a command."""

    def __init__(self) -> None:
        super().__init__("excitation")
        self.robot = ExcitationParameters(device=DEVICE).build()
        self.supervisor: Any = self.robot.supervisor
        for active in (False, True):  # compiles
            self.supervisor.step(self.supervisor.init(), zero_sample(self.robot, 0.0), active)
        self.state, self.samples, self.origin = self.supervisor.init(), 0, 0
        self.commands = self.create_publisher(VsaCommand, self.robot.command_name, DEPTH)
        self.states = self.create_publisher(ControlState, f"/{self.robot.name}/control", DEPTH)
        self.create_subscription(JointState, "/joint_states", self.take, DEPTH)

    def take(self, message: JointState) -> None:
        """Answer one sample."""
        device, stamp = self.robot.axes.device, _nanoseconds(message)
        self.origin = self.origin or stamp
        angle = dict(zip(message.name, message.position, strict=True))
        theta = np.array([angle[joint] for joint in device.motor_joints])
        sample = JointSample((stamp - self.origin) / SECOND, angle[device.link_joint], theta)
        self.state, answer = self.supervisor.step(self.state, sample, True)
        command = VsaCommand(header=message.header, sequence=self.samples, mode=VsaCommand.MOTOR_TORQUE)
        command.damping = self.robot.damping
        command.motor = answer.torque.tolist()
        self.commands.publish(command)
        arm, quantities = self.supervisor.limits.arm, self.supervisor.controller.quantities
        state = ControlState(header=message.header, sequence=self.samples, method="excitation")
        state.activity, state.limited = int(answer.activity), int(answer.limited)
        state.name, state.unit = [each.name for each in quantities], [each.unit for each in quantities]
        state.value = self.supervisor.observe(self.state).tolist()
        state.torque_limit, state.speed_limit = arm.torque_limit.tolist(), arm.speed_limit.tolist()
        state.deflection_limit = arm.deflection_limit.tolist()
        self.states.publish(state)
        self.samples += 1


def _nanoseconds(message: Any) -> int:
    return int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec)


def simulator(seconds: float) -> Part:
    """The simulator, which ends after `seconds`."""
    node = PlainSimulator(seconds)

    def counts() -> dict[str, float]:
        return simulated(node.ticks, 1.0 - node.ticks / max(node.due, 1), node.round_trips)

    return Part(node, counts, node.finished, lambda: node.ticks > 0)


def estimator(number: int) -> Part:
    """The estimator with one method."""
    node = PlainEstimator(number)
    return Part(node, lambda: {"samples": node.samples})


def controller() -> Part:
    """The controller."""
    node = PlainController()
    return Part(node, lambda: {"samples": node.samples})
