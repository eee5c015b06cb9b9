"""Node `excitation`: keeps an antagonistic joint moving so that its stiffness can be told.

ros2 run via_controllers excitation --ros-args -p device:=cubic_demo

Topics and lifecycle: see `controller`. It tells equilibrium and preset that the motors are led to. They begin where the
first sample finds the motors, and do so again after it was inactive.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

from via_core.device_parts import TorqueMotor
from via_core.devices import Device, load_device
from via_core.errors import ParameterError
from via_ros import spin

from via_controllers.joint_axes import JointAxes
from via_controllers.motor_position import MotorPositionControl
from via_controllers.multisine import Multisine
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import Equipment, StartParameters, joint_equipment


def setting(default: Any, description: str, unit: str, low: float, high: float) -> Any:
    """A dataclass field with what a ROS parameter needs."""
    return field(default=default, metadata={"description": description, "unit": unit, "range": (low, high)})


@dataclass(frozen=True)
class ExcitationParameters(StartParameters):
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


def driven(parameters: ExcitationParameters) -> Device:
    """The device, its motors with torque limits; raises ParameterError if it is not antagonistic with torque drive."""
    device = load_device(parameters.device)
    if device.arrangement != "antagonistic" or device.drive != "torque":
        raise ParameterError(
            f"device: excitation needs an antagonistic device with torque drive, "
            f"'{device.name}' is {device.arrangement} with {device.drive} drive"
        )
    motors = tuple(
        motor.model_copy(update={"torque_limit": motor.torque_limit or parameters.torque_limit})
        for motor in device.motors
        if isinstance(motor, TorqueMotor)
    )
    return device.model_copy(update={"motors": motors})


def law_of(parameters: ExcitationParameters, axes: JointAxes) -> MotorPositionControl:
    """The control law of the node; raises ParameterError."""
    p = parameters
    first, second = axes.device.spring_laws
    return MotorPositionControl(
        springs=(first, second),
        equilibrium=Multisine(p.equilibrium_mean, p.equilibrium_amplitudes, p.equilibrium_frequencies),
        preset=Multisine(p.preset_mean, p.preset_amplitudes, p.preset_frequencies),
        proportional_gain=p.proportional_gain,
        derivative_gain=p.derivative_gain,
        velocity_bandwidth=p.velocity_bandwidth,
        torque_limit=(float(axes.torque_limit[0]), float(axes.torque_limit[1])),
        fade_in=p.fade_in,
    )


def equipment_of(parameters: ExcitationParameters) -> Equipment:
    """The joint and the law of the node; raises ParameterError or DeviceError."""
    axes = JointAxes(driven(parameters))
    return joint_equipment(axes, law_of(parameters, axes))


class ExcitationNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("excitation", ExcitationParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(ExcitationNode)


if __name__ == "__main__":
    sys.exit(main())
