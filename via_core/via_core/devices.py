"""Device files: one YAML file per joint with its parameters, their sources and their tolerances.

    device = load_device("maccepavd")            # a shipped file, see device_names()
    device = load_device("my_robot/joint.yaml")  # or your own

Impossible values are refused here with one line that names file, key, value and allowed range, so that plants,
estimators and nodes need not check again.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from via_core.dampers import Damping
from via_core.device_parts import (
    Link,
    Motor,
    Observed,
    PositionDrive,
    Sensors,
    Tolerances,
    TorqueMotor,
    Wire,
    motor_kind,
)
from via_core.errors import DeviceError, ParameterError
from via_core.records import Described, Positive, parse_record, read_record, shipped_names
from via_core.signals import Array
from via_core.springs import Spring
from via_core.wire import DRIVE, MOTOR, command_name, link_name, motor_name

MOTORS = {"rigid": 0, "flexible": 1, "antagonistic": 2, "serial": 2}
SPRINGS = {"rigid": 0, "flexible": 1, "antagonistic": 2, "serial": 1}


class Device(Described):
    """One joint with its actuator, as described by its device file."""

    arrangement: Literal["rigid", "flexible", "antagonistic", "serial"]
    drive: Literal["torque", "servo", "position"] = "torque"
    link: Link
    servo: PositionDrive | None = None
    motors: tuple[Motor, ...] = ()
    springs: tuple[Spring, ...] = ()
    damper: Damping | None = None
    torque_scale: Positive = 1.0  # torque that acts per torque that is commanded or recorded; of all torque drives
    sensors: Sensors
    observed: Observed = Observed()
    tolerances: Tolerances = Tolerances()
    wire: Wire = Wire()

    @model_validator(mode="after")
    def _fits_together(self) -> Device:
        for part, wanted in (("motors", MOTORS[self.arrangement]), ("springs", SPRINGS[self.arrangement])):
            has = len(getattr(self, part))
            if has != wanted:
                raise ValueError(f"{part}: arrangement '{self.arrangement}' needs exactly {wanted}, got {has}")
        if self.drive == "position" and self.arrangement != "rigid":
            raise ValueError(f"drive: 'position' needs arrangement 'rigid', got '{self.arrangement}'")
        if (self.servo is not None) != (self.drive == "position"):
            raise ValueError("servo: is missing" if self.servo is None else f"servo: drive '{self.drive}' has none")
        for i, motor in enumerate(self.motors):
            if motor_kind(motor) != self.drive:
                raise ValueError(f"motors.{i}: drive is '{self.drive}' but this is a {motor_kind(motor)} motor")
        if self.torque_scale != 1.0 and self.drive != "torque":
            raise ValueError(f"torque_scale: drive '{self.drive}' has no torque command")
        if self.damper is not None and self.damper.site == "transmission" and not self.springs:
            raise ValueError("damper.site: 'transmission' needs a transmission, and a rigid joint has none")
        if len(self.wire.motors) not in (0, self.n_drives):
            raise ValueError(f"wire.motors: needs 0 or {self.n_drives} names, got {len(self.wire.motors)}")
        return self

    @property
    def n_motors(self) -> int:
        return len(self.motors)

    @property
    def torque_motors(self) -> tuple[TorqueMotor, ...]:
        """All motors of a torque drive; none of servos."""
        return tuple(motor for motor in self.motors if isinstance(motor, TorqueMotor))

    @property
    def n_transmissions(self) -> int:
        return len(self.springs)

    def damping_of(self, u: ArrayLike) -> Array:
        """Damping [N m s/rad] that the damper adds at command u [-]; zero for a device without damper."""
        return np.zeros(np.shape(u)) if self.damper is None else self.damper.value(u)

    @property
    def link_joint(self) -> str:
        """Name of the link in sensor_msgs/JointState."""
        return self.wire.link or link_name(self.name)

    @property
    def n_drives(self) -> int:
        """Number of drives whose torque is published: one per motor, or the link drive of a rigid joint."""
        return self.n_motors or 1

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Names of the drives in sensor_msgs/JointState: the motors, or the link drive of a rigid joint."""
        return self.wire.motors or tuple(motor_name(self.name, i) for i in range(1, self.n_drives + 1))

    @property
    def drive_channels(self) -> dict[str, str]:
        """Channel of a drive -> JointState array; the drive of a rigid joint has a torque only."""
        return MOTOR if self.n_motors else DRIVE

    @property
    def motor_joints(self) -> tuple[str, ...]:
        """Names of the motors in sensor_msgs/JointState."""
        return self.drive_joints[: self.n_motors]

    @property
    def command_name(self) -> str:
        """Topic of the commands as nodes use it: relative to their namespace unless it begins with a slash."""
        return self.wire.command or command_name(self.name)

    @property
    def command_topic(self) -> str:
        """Topic of the commands in a bag of nodes without a namespace."""
        return self.command_name if self.command_name.startswith("/") else f"/{self.command_name}"

    def motor_angles(self, equilibrium: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """Motor angles (..., m) [rad] at rest: antagonistic eq +- preset, serial (eq, preset), flexible (eq,)."""
        eq, p = np.broadcast_arrays(np.asarray(equilibrium, dtype=np.float64), np.asarray(preset, dtype=np.float64))
        columns = {"rigid": (), "flexible": (eq,), "antagonistic": (eq + p, eq - p), "serial": (eq, p)}
        return np.stack(columns[self.arrangement], axis=-1) if self.n_motors else np.empty((*eq.shape, 0))

    def torque_each(self, q: ArrayLike, theta: ArrayLike, preset: ArrayLike | None = None) -> Array:
        """tau_e,i (..., n_transmissions) [N m]; arguments as for `stiffness`."""
        return self._each("torque", q, theta, preset)

    def stiffness_each(self, q: ArrayLike, theta: ArrayLike, preset: ArrayLike | None = None) -> Array:
        """sigma_i (..., n_transmissions) [N m/rad]; arguments as for `stiffness`."""
        return self._each("stiffness", q, theta, preset)

    def stiffness(self, q: ArrayLike, theta: ArrayLike, preset: ArrayLike | None = None) -> Array:
        """Total device stiffness (...) [N m/rad] from the spring laws, eq. (7).

        q       (...) link angle [rad]
        theta   (..., m) motor angles [rad]
        preset  (...) angle of the preset motor of a serial device [rad]; default: the second column of theta
        """
        return self._each("stiffness", q, theta, preset).sum(axis=-1)

    def _each(self, what: str, q: ArrayLike, theta: ArrayLike, preset: ArrayLike | None) -> Array:
        link, motor = np.asarray(q, dtype=np.float64), np.asarray(theta, dtype=np.float64)
        if motor.shape[-1:] != (self.n_motors,):
            raise ParameterError(f"theta must end in ({self.n_motors},) for '{self.name}', got shape {motor.shape}")
        values = []
        for i, spring in enumerate(self.springs):
            own = motor[..., i]  # antagonistic springs may depend on their own motor's angle besides the deflection
            if self.arrangement == "serial":
                own = motor[..., 1] if preset is None else np.asarray(preset, dtype=np.float64)
            values.append(getattr(spring, what)(link - motor[..., i], own))
        return np.stack(values, axis=-1) if values else np.zeros((*link.shape, 0))


def device_names() -> tuple[str, ...]:
    """Names of the shipped devices, sorted."""
    return shipped_names("devices")


def load_device(name_or_path: str | Path) -> Device:
    """The shipped device of that name, or the device of a YAML file.

    'reference_4dof:elbow' is a joint of an arm: its name, or the path of its YAML, and the name of the joint.
    'elbow=qbmove_a' is the device qbmove_a named elbow, with joint names and topics to match, so that one file serves
    several joints of an arm. Names listed under `wire` in the file stay.
    Raises DeviceError: no such device, unreadable file, bad YAML, or an invalid key or value.
    """
    renamed = re.fullmatch(r"([a-z][a-z0-9_]*)=(.+)", name_or_path) if isinstance(name_or_path, str) else None
    if renamed:
        return load_device(renamed[2]).model_copy(update={"name": renamed[1]})
    of_arm = re.fullmatch(r"(.+):([a-z][a-z0-9_]*)", name_or_path) if isinstance(name_or_path, str) else None
    if of_arm:
        from via_core.arm_joints import arm_joint  # imports pinocchio

        return arm_joint(of_arm[1], of_arm[2])
    return read_record(Device, name_or_path, "devices", DeviceError)[1]


def parse_device(text: str, file: str) -> Device:
    """The device described by YAML `text`; `file` is the name in errors. Raises DeviceError."""
    return parse_record(Device, text, file, DeviceError)
