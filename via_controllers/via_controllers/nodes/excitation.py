"""Node `excitation`: keeps an antagonistic joint moving so that its stiffness can be told.

subscribes  /joint_states     sensor_msgs/JointState
publishes   /<device>/command via_interfaces/VsaCommand, motor torques, stamped with the sample they answer
            /diagnostics      once per second of wall time

A sample that cannot be used is answered with zero torque and counted. A stamp that goes backward starts the law anew.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_interfaces.msg import VsaCommand
from via_ros import qos, spin
from via_ros.conversions import Command, CommandWriter, SampleReader, nanoseconds
from via_ros.parameters import declare

from via_controllers.contract import JointSample
from via_controllers.motor_position import MotorPositionControl
from via_controllers.multisine import Multisine

REPORT = 1.0  # [s] between two diagnostics


def setting(default: Any, description: str, unit: str, low: float, high: float) -> Any:
    """A dataclass field with what a ROS parameter needs; for lists the factory keeps the default immutable."""
    return field(default=default, metadata={"description": description, "unit": unit, "range": (low, high)})


@dataclass(frozen=True)
class ExcitationParameters:
    """Parameters of the node."""

    device: str = field(default="cubic_demo", metadata={"description": "device name or path to its YAML"})
    equilibrium_mean: float = setting(0.0, "mean of the equilibrium angle", "rad", -10.0, 10.0)
    equilibrium_amplitudes: tuple[float, ...] = field(
        default=(0.2, 0.1), metadata={"description": "amplitudes of its tones [rad]"}
    )
    equilibrium_frequencies: tuple[float, ...] = field(
        default=(0.7, 1.9), metadata={"description": "frequencies of its tones [Hz]"}
    )
    preset_mean: float = setting(0.6, "mean of the stiffness preset", "rad", -10.0, 10.0)
    preset_amplitudes: tuple[float, ...] = field(
        default=(0.2,), metadata={"description": "amplitudes of its tones [rad]"}
    )
    preset_frequencies: tuple[float, ...] = field(
        default=(0.3,), metadata={"description": "frequencies of its tones [Hz]"}
    )
    fade_in: float = setting(0.3, "time over which the references fade in", "s", 1e-3, 100.0)
    proportional_gain: float = setting(20.0, "K_P", "N m/rad", 1e-9, 1e6)
    derivative_gain: float = setting(0.6, "K_D", "N m s/rad", 0.0, 1e6)
    velocity_bandwidth: float = setting(300.0, "low pass of the motor velocity", "rad/s", 1e-3, 1e5)
    torque_limit: float = setting(10.0, "limit of each motor where the device file has none", "N m", 1e-9, 1e6)


def law_of(parameters: ExcitationParameters) -> MotorPositionControl:
    """The control law of the node; raises ParameterError for a device that is not antagonistic with torque drive."""
    device = load_device(parameters.device)
    if device.arrangement != "antagonistic" or device.drive != "torque":
        raise ParameterError(
            f"device: excitation needs an antagonistic device with torque drive, "
            f"'{device.name}' is {device.arrangement} with {device.drive} drive"
        )
    limits = [getattr(motor, "torque_limit", None) or parameters.torque_limit for motor in device.motors]
    p = parameters
    first, second = device.spring_laws
    return MotorPositionControl(
        springs=(first, second),
        equilibrium=Multisine(p.equilibrium_mean, p.equilibrium_amplitudes, p.equilibrium_frequencies),
        preset=Multisine(p.preset_mean, p.preset_amplitudes, p.preset_frequencies),
        proportional_gain=p.proportional_gain,
        derivative_gain=p.derivative_gain,
        velocity_bandwidth=p.velocity_bandwidth,
        torque_limit=(limits[0], limits[1]),
        fade_in=p.fade_in,
    )


class ExcitationNode(Node):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("excitation", **options)
        parameters = declare(self, ExcitationParameters)
        self.law = law_of(parameters)
        self.state = self.law.init()
        self.answered = self.skipped = self._reported = 0
        self._device = device = load_device(parameters.device)
        self._reader = SampleReader(device, ("q", "theta_1", "theta_2"))
        self._writer = CommandWriter(device)
        # Loads the compiled springs before a sample waits for them.
        self.law.step(self.state, JointSample(0.0, 0.0, np.zeros(2)))
        self._commands = self.create_publisher(VsaCommand, device.command_topic, qos.CONTROL)
        self.create_subscription(JointState, "/joint_states", self._answer, qos.CONTROL)
        self._reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
        self.create_timer(REPORT, self._report, clock=spin.STEADY)

    def _answer(self, message: JointState) -> None:
        row = self._reader.read(message)
        if row is None:
            return
        if row[0] < self.state.time:
            self.state = self.law.init()
        before = self.state
        self.state, out = self.law.step(before, JointSample(row[0], row[1], row[2:]))
        self.answered += 1
        self.skipped += self.state is before
        command = Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, 0.0, out.torque)
        self._commands.publish(self._writer.numbered(nanoseconds(message.header.stamp), command))

    def _report(self) -> None:
        malformed, silent = self._reader.malformed, self.answered == self._reported
        self._reported = self.answered
        troubles = {"no samples": silent, "skipped samples": self.skipped > 0, "malformed messages": malformed > 0}
        told = [text for text, holds in troubles.items() if holds]
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if told else DiagnosticStatus.OK,
            name=f"{self.get_name()}: motor position",
            message=", ".join(told) or "running",
            hardware_id=self._device.name,
        )
        values = {"samples": self.answered, "skipped samples": self.skipped, "malformed messages": malformed}
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._reports.publish(report)


def main() -> int:
    """Run the node."""
    return spin.run(ExcitationNode)
