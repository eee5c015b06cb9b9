"""Joints, motion and noise of the comparison, the same for every method. They were fixed before the first results.

Joints: the three published parameter sets of the qbmove. Motion: motors under position control (eq. (120)) along two
multisines for equilibrium and preset, which deflect both transmissions by .03 to .52 rad of the .8 rad at the stop, for
30 s at 1 kHz. The torques of one noise-free run are replayed for every seed. All seeds and all levels with the same
friction therefore have the same motion and differ only in the sensors.

A method is set up from the device file with the encoders and torque noise of the level. It has the sensor data and the
nominal inertia and damping of the motors, but not their dry friction, and of the springs only the order of magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.joints.multisine import Multisine
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import InitialConditions, Simulation, Simulator, simulate

RATE = 1000.0  # [Hz]
DURATION = 30.0  # [s]
DEVICES = ("qbmove_a", "qbmove_b", "qbmove_alterego")
PROPORTIONAL_GAIN, DERIVATIVE_GAIN = 125.0, 4.5  # of the qbmove's Gazebo plugin
VELOCITY_BANDWIDTH, FADE_IN = 300.0, 1.0  # [rad/s], [s]
EQUILIBRIUM = Multisine(0.0, (0.12, 0.06, 0.03), (0.4, 1.1, 2.3))  # [rad], [Hz]
PRESET = Multisine(0.33, (0.12, 0.05), (0.27, 0.9))


@dataclass(frozen=True)
class Level:
    """Sensor quality, and whether the motors have the dry friction of their device file."""

    name: str
    encoder_bits: int  # per turn, link and motors; 0: exact
    torque_noise: float  # [N m] standard deviation
    velocity_noise: float  # [rad/s] of the motor velocity, which only some methods use
    friction: bool

    @property
    def quantum(self) -> float:
        """Encoder step [rad]; 0 for exact angles."""
        return 2.0 * pi / 2**self.encoder_bits if self.encoder_bits else 0.0

    @property
    def sensors(self) -> Sensors:
        """Sensors of this quality."""
        return Sensors(
            link_quantum=self.quantum,
            motor_quantum=self.quantum,
            torque_noise=self.torque_noise,
            velocity_noise=self.velocity_noise,
        )

    def __str__(self) -> str:
        encoders = f"{self.encoder_bits} bit encoders" if self.encoder_bits else "exact angles"
        friction = "dry friction as published" if self.friction else "no dry friction"
        noise = f"torque noise {self.torque_noise:g} N m, velocity noise {self.velocity_noise:g} rad/s"
        return f"{encoders}, {noise}, {friction}"


LEVELS = (
    Level("ideal", 0, 0.0, 0.0, False),
    Level("mild", 16, 0.01, 0.005, True),
    Level("realistic", 14, 0.03, 0.02, True),
    Level("harsh", 12, 0.1, 0.1, True),
)


def seen_by_estimators(device: Device, level: Level, inertia: float = 1.0, damping: float = 1.0) -> Device:
    """The device file with the level's sensors, and with the motors' inertia and damping scaled by these factors."""
    quantum = level.quantum or None
    sensors = device.sensors.model_copy(
        update={"link_quantum": quantum, "motor_quantum": quantum, "torque_noise": level.torque_noise}
    )
    motors = tuple(
        motor.model_copy(
            update={"inertia": inertia * motor.inertia, "viscous_friction": damping * motor.viscous_friction}
        )
        for motor in _motors(device)
    )
    return device.model_copy(update={"sensors": sensors, "motors": motors})


def without_friction(device: Device) -> Device:
    """The device without dry friction of the motors."""
    motors = tuple(motor.model_copy(update={"coulomb_friction": 0.0}) for motor in _motors(device))
    return device.model_copy(update={"motors": motors})


@dataclass(frozen=True)
class Motion:
    """A joint's motion, to be measured with different noise."""

    plant: JointPlant
    torques: Signals  # commands of the noise-free closed loop

    def measured(self, level: Level, seed: int) -> Simulation:
        """The motion measured by the level's sensors."""
        initial = InitialConditions(seed=seed)
        return simulate(self.plant, self.torques, len(self.torques) / RATE, RATE, level.sensors, initial)


def position_control(
    device: Device, equilibrium: Multisine = EQUILIBRIUM, preset: Multisine = PRESET
) -> MotorPositionControl:
    """The controller of the closed loop."""
    first, second = device.springs
    limits = [motor.torque_limit or np.inf for motor in _motors(device)]
    return MotorPositionControl(
        springs=(first, second),
        equilibrium=equilibrium,
        preset=preset,
        proportional_gain=PROPORTIONAL_GAIN,
        derivative_gain=DERIVATIVE_GAIN,
        velocity_bandwidth=VELOCITY_BANDWIDTH,
        torque_limit=(limits[0], limits[1]),
        fade_in=FADE_IN,
    )


def motion_of(device: Device, friction: bool, duration: float = DURATION) -> Motion:
    """Simulate the closed loop without noise; `duration` [s]. Raises ParameterError for an unsuitable device."""
    if device.arrangement != "antagonistic" or device.drive != "torque":
        raise ParameterError(f"'{device.name}' is not an antagonistic joint with torque-driven motors")
    plant = JointPlant.from_device(device if friction else without_friction(device))
    controller, simulator = position_control(device), Simulator(plant, RATE, IDEAL)
    state, memory = simulator.init(), controller.init()
    measured, _ = simulator.sample(state)
    torques = np.empty((round(duration * RATE), 2))
    for k in range(len(torques)):
        memory, answer = controller.step(memory, JointSample(k / RATE, float(measured[0]), measured[1:3]))
        torques[k] = answer.torque
        state, measured, _ = simulator.step(state, [*answer.torque, 0.0, 0.0])
    time = np.arange(len(torques)) / RATE
    return Motion(plant, Signals(time, {"motor": torques}, {"motor": "N m"}, frozenset({"motor"})))


def _motors(device: Device) -> tuple[TorqueMotor, ...]:
    motors = tuple(motor for motor in device.motors if isinstance(motor, TorqueMotor))
    if len(motors) != device.n_motors or not motors:
        raise ParameterError(f"'{device.name}' has no torque-driven motors")
    return motors
