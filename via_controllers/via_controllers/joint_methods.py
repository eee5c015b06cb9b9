"""Parameters of the controllers of joints, each declared once, and the controllers built from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from via_core.command_files import read_motion, read_references
from via_core.devices import Device, load_device
from via_core.parameters import parameter

from via_controllers.contract import require
from via_controllers.joint_axes import JointAxes
from via_controllers.joints.bang_bang_joint import JointBangBang
from via_controllers.joints.commanded_torque import CommandedTorque
from via_controllers.joints.equilibrium_preset import FURTHEST, EquilibriumPreset, EquilibriumPresetState
from via_controllers.joints.max_velocity import MaxVelocity, joint_of
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.joints.multisine import Multisine
from via_controllers.joints.played_commands import PlayedCommands
from via_controllers.robot import ControlledJoint, ControllerParameters
from via_controllers.supervision.joint_supervision import JointSupervisor

DEVICE = "device name or path to its YAML"


@dataclass(frozen=True)
class ExcitationParameters(ControllerParameters):
    """Parameters of `motor_position` with multisine references, or of `played_commands` with a table of torques."""

    device: str = parameter("cubic_demo", DEVICE)
    equilibrium_mean: float = parameter(0.0, "mean of the equilibrium angle", "rad", (-10.0, 10.0))
    equilibrium_amplitudes: tuple[float, ...] = parameter((0.2, 0.1), "amplitudes of its tones", "rad")
    equilibrium_frequencies: tuple[float, ...] = parameter((0.7, 1.9), "frequencies of its tones", "Hz")
    preset_mean: float = parameter(0.6, "mean of the stiffness preset", "rad", (-10.0, 10.0))
    preset_amplitudes: tuple[float, ...] = parameter((0.2,), "amplitudes of its tones", "rad")
    preset_frequencies: tuple[float, ...] = parameter((0.3,), "frequencies of its tones", "Hz")
    fade_in: float = parameter(0.3, "time over which the references fade in", "s", (1e-3, 100.0))
    proportional_gain: float = parameter(20.0, "K_P", "N m/rad", (1e-9, 1e6))
    derivative_gain: float = parameter(0.6, "K_D", "N m s/rad", (0.0, 1e6))
    velocity_bandwidth: float = parameter(300.0, "low pass of the motor velocity", "rad/s", (1e-3, 1e5))
    torque_limit: float = parameter(10.0, "limit of each motor where the device file has none", "N m", (1e-9, 1e6))
    commands: str = parameter("", "table of motor torques to play (.csv); empty: the multisines")

    def build(self) -> ControlledJoint:
        return self.of(load_device(self.device))

    def of(self, device: Device) -> ControlledJoint:
        """The robot of a device, whatever its name. Raises ParameterError for a device that does not fit."""
        limited = self._limited(device)
        axes = JointAxes(limited)
        own = {"torque_limit": tuple(axes.torque_limit.tolist())}
        if self.commands:
            path = Path(self.commands)
            given = read_motion(path, limited)
            require("motor" in given, f"commands: {path} has no motor torques")
            played: dict[str, Any] = {
                "time": given.time, "torque": given["motor"], "reference": read_references(path, limited),
            }  # fmt: skip
            player = PlayedCommands(**self.shared(PlayedCommands) | own | played)
            return ControlledJoint(axes, JointSupervisor.of(player, axes))
        sines: dict[str, Any] = {
            "springs": limited.springs,
            "equilibrium": Multisine(self.equilibrium_mean, self.equilibrium_amplitudes, self.equilibrium_frequencies),
            "preset": Multisine(self.preset_mean, self.preset_amplitudes, self.preset_frequencies),
        }
        controller = MotorPositionControl(**self.shared(MotorPositionControl) | own | sines)
        return ControlledJoint(axes, JointSupervisor.of(controller, axes))

    def _limited(self, device: Device) -> Device:
        """The device, its motors with torque limits; the multisines need an antagonistic device with torque drive."""
        suits = device.drive == "torque" and (device.arrangement == "antagonistic" or self.commands != "")
        require(
            suits and device.n_motors > 0,
            f"device: excitation needs an antagonistic device with torque drive, "
            f"'{device.name}' is {device.arrangement} with {device.drive} drive",
        )
        motors = tuple(
            motor.model_copy(update={"torque_limit": motor.torque_limit or self.torque_limit})
            for motor in device.torque_motors
        )
        return device.model_copy(update={"motors": motors})


@dataclass(frozen=True)
class EquilibriumPresetParameters(ControllerParameters):
    """Parameters of `equilibrium_preset`; the node also subscribes to references and estimates."""

    device: str = parameter("qbmove_a", DEVICE)
    equilibrium: float = parameter(0.0, "initial reference of the link angle", "rad", (-FURTHEST, FURTHEST))
    stiffness: float = parameter(
        0.0, "initial reference of the stiffness; 0: that of the middle preset", "N m/rad", (0.0, 1e9)
    )
    feedback: bool = parameter(False, "correct the spring laws with the estimated stiffness")
    bandwidth: float = parameter(60.0, "w of the motor control", "rad/s", (1.0, 1e4))
    speed: float = parameter(2.0, "largest rate of the motor references", "rad/s", (1e-3, 1e3))
    correction_time: float = parameter(1.0, "T, mean delay of the correction", "s", (1e-2, 1e4))
    fallback_time: float = parameter(
        30.0, "time constant at which the correction ends while the estimator is not OK", "s", (1e-2, 1e6)
    )
    trusted_deviation: float = parameter(
        0.1, "S, relative standard deviation at which an estimate has half weight", "-", (1e-3, 10.0)
    )

    def controller(self) -> EquilibriumPreset:
        """The controller; raises ParameterError or DeviceError."""
        nominal = EquilibriumPreset.from_device(load_device(self.device), self.bandwidth)
        return replace(nominal, **self.shared(EquilibriumPreset))

    def initial(self, controller: EquilibriumPreset) -> EquilibriumPresetState:
        """The controller's state with the initial references; raises UnreachableError."""
        references = controller.references
        stiffness = self.stiffness or references.stiffness(self.equilibrium, 0.5 * sum(references.presets))
        return controller.with_reference(controller.init(), self.equilibrium, stiffness)

    def build(self) -> ControlledJoint:
        controller = self.controller()
        axes, start = JointAxes(controller.references.device), self.initial(controller)
        return ControlledJoint(axes, JointSupervisor.of(controller, axes, lambda: start))


@dataclass(frozen=True)
class BangBangJointParameters(ControllerParameters):
    """Parameters of `bang_bang_joint`."""

    device: str = parameter("visco_elastic_demo", DEVICE)
    equilibrium: float = parameter(0.0, "equilibrium of theta_0", "rad", (-10.0, 10.0))
    preset: float = parameter(0.0, "stiffness preset of theta_0", "rad", (-10.0, 10.0))
    amplitude: float = parameter(0.03, "theta_hat, switching amplitude of the motors", "rad", (0.0, 10.0), live=True)
    threshold: float = parameter(0.1, "epsilon, least |tau_z| at which the motors switch", "N m", (0.0, 1e6), live=True)
    bandwidth: float = parameter(60.0, "omega_m of the motor control", "rad/s", (1.0, 1e4))
    velocity_bandwidth: float = parameter(500.0, "low pass of the motor velocities", "rad/s", (1e-3, 1e5))
    start: float = parameter(1.0, "time at rest before a push by the motors; 0: none", "s", (0.0, 1e3), live=True)

    def build(self) -> ControlledJoint:
        device = load_device(self.device)
        controller = JointBangBang(**self.shared(JointBangBang) | {"device": device})
        axes = JointAxes(device)
        return ControlledJoint(axes, JointSupervisor.of(controller, axes))


@dataclass(frozen=True)
class MaxVelocityParameters(ControllerParameters):
    """Parameters of `max_velocity`."""

    device: str = parameter("visco_elastic_demo", DEVICE)
    turns: int = parameter(3, "number of half swings before the last stretch", "", (0, 1000))
    damping: float = parameter(0.0, "damper command during the motion", "-", (0.0, 1.0))
    bandwidth: float = parameter(100.0, "w of the motor control", "rad/s", (1.0, 1e4))
    # Above 0.9 the speed limit is exceeded whatever the controller does: filtered velocities are delayed.
    speed_share: float = parameter(0.9, "used share of the motor's speed limit", "-", (0.01, 0.9))

    def build(self) -> ControlledJoint:
        device = load_device(self.device)
        joint = joint_of(device, self.damping)
        horizon = joint.first_turn + self.turns * joint.between_turns
        controller = MaxVelocity.from_device(device, horizon, self.damping, self.bandwidth)
        controller = replace(controller, velocity=self.speed_share * controller.velocity)
        # The optimum runs the motor at full speed: no speed is reserved for following the link.
        axes = JointAxes(device, self.damping)
        return ControlledJoint(axes, JointSupervisor.of(controller, axes, drive=self.speed_share))


@dataclass(frozen=True)
class CommandedTorqueParameters(ControllerParameters):
    """Parameters of `commanded_torque`; the node also subscribes to the torques."""

    device: str = parameter("qbmove_a", DEVICE)
    timeout: float = parameter(0.02, "age of a command from which the torque is zero", "s", (1e-3, 0.1))

    def controller(self, axes: JointAxes) -> CommandedTorque:
        """The controller of a device's axes."""
        return CommandedTorque(tuple(axes.torque_limit.tolist()), self.timeout)

    def build(self) -> ControlledJoint:
        axes = JointAxes(load_device(self.device))
        return ControlledJoint(axes, JointSupervisor.of(self.controller(axes), axes))
