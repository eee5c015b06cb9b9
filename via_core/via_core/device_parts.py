"""The entries of a device file: link, motors, sensors, tolerances and names, each checked when it is read.

Springs are described in `via_core.springs`, dampers in `via_core.dampers`.
"""

from __future__ import annotations

import re
from functools import cached_property
from math import tau
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Discriminator, Field, Tag, model_validator

from via_core.errors import ParameterError
from via_core.recordings.units import factor, kind, split_unit
from via_core.records import NotNegative, Number, Positive, Record, Text
from via_core.signals import Array
from via_core.wire import UNITS

LONGEST_DELAY = 0.1  # [s] of a drive, effects included: simulators keep as many commands


class Link(Record):
    """M qdd + Dq qd + Coulomb + sum tau_e + gravity_torque sin(q - gravity_angle) = tau_ext."""

    inertia: Positive  # M [kg m^2]
    viscous_friction: NotNegative  # Dq [N m s/rad]
    coulomb_friction: NotNegative = 0.0  # [N m]
    gravity_torque: Number = 0.0  # [N m] largest gravity torque
    gravity_angle: Number = 0.0  # [rad] angle at which the link hangs at rest


class TorqueMotor(Record):
    """A torque-controlled motor with its own dynamics: B thdd + Dth thd - tau_e(phi) = tau."""

    inertia: Positive  # B [kg m^2], reflected to the joint
    viscous_friction: NotNegative  # Dth [N m s/rad]
    coulomb_friction: NotNegative = 0.0  # [N m]
    torque_limit: Positive | None = None  # [N m]; None: unknown
    speed_limit: Positive | None = None  # [rad/s]; None: unknown


class ServoMotor(Record):
    """A position servo: critically damped second-order lag that the spring torque does not back-drive."""

    bandwidth: Positive  # w [rad/s]


class PositionDrive(Record):
    """A position-controlled drive on the link of a rigid joint; it measures neither motor angle nor torque.

        tau = clip(kp (goal - q) + i, -torque_limit, torque_limit) - kd qd      limited: proportional
        tau = clip(kp (goal - q) + i - kd qd, -torque_limit, torque_limit)      limited: sum, as in MuJoCo and Gazebo
        di/dt = ki (goal - q),  |i| <= integral_limit and torque_limit

    With `feedforward` f, f kd d(goal)/dt is added to kp (goal - q); at 1, kd acts on the derivative of the error.

    `goal` is the command of `delay` seconds ago. A NaN goal switches the drive off: its torque is zero. For a DC servo
    with supply voltage V, torque constant kt and resistance R (seen at the joint) whose duty cycle is proportional to
    the error: kp = kt V/R times duty per error, torque_limit = kt V/R (full duty), kd = kt^2/R (back EMF).
    """

    kp: Positive  # [N m/rad]
    kd: NotNegative  # [N m s/rad]
    ki: NotNegative = 0.0  # [N m/(rad s)]
    torque_limit: Positive | None = None  # [N m]; None: unknown
    integral_limit: Positive | None = None  # [N m]; None: no other than torque_limit
    feedforward: NotNegative = 0.0  # share of kd that acts on the speed of the goal
    limited: Literal["proportional", "sum"] = "proportional"
    speed_limit: Positive | None = None  # [rad/s] slew rate of the drive's internal goal; None: unknown
    delay: Annotated[float, Field(strict=True, ge=0.0, le=LONGEST_DELAY)] = 0.0  # [s] dead time of the goal

    def led(self, goal: Array, time: Array) -> Array:
        """Goals (N,) [rad] at `time` (N,) [s] with their feedforward; the speed of a goal is that of its change."""
        if self.feedforward == 0.0 or len(goal) < 2:
            return goal
        speed = np.diff(goal, prepend=goal[:1]) / np.diff(time, prepend=2.0 * time[0] - time[1])
        return np.asarray(goal + self.feedforward * self.kd / self.kp * np.nan_to_num(speed))

    def torque(self, error: Array, speed: Array) -> Array:
        """Torque [N m] at errors goal - q [rad] and speeds [rad/s], without the integral."""
        pull, brake, limit = self.kp * error, self.kd * speed, self.torque_limit or np.inf
        if self.limited == "sum":
            return np.asarray(np.clip(pull - brake, -limit, limit))
        return np.asarray(np.clip(pull, -limit, limit) - brake)


def motor_kind(motor: Any) -> str:
    """'servo' or 'torque', by the keys of an entry or the fields of a model."""
    has = motor.keys() if isinstance(motor, dict) else vars(motor).keys() if isinstance(motor, BaseModel) else ()
    return "servo" if "bandwidth" in has else "torque"


Motor = Annotated[
    Annotated[TorqueMotor, Tag("torque")] | Annotated[ServoMotor, Tag("servo")], Discriminator(motor_kind)
]


class Sensors(Record):
    """Sensors of the device; an omitted quantum means an ideal sensor."""

    rate: Positive  # [Hz]
    link_quantum: Positive | None = None  # [rad] encoder step at the link
    motor_quantum: Positive | None = None  # [rad] encoder step at the motors
    torque_noise: NotNegative = 0.0  # [N m] standard deviation of the motor torque measurement
    link_torque_noise: NotNegative | None = None  # [N m] standard deviation of a link torque sensor; None: no sensor


class Observed(Record):
    """Behaviour seen in the device's logs beyond its published model; used by estimators, not by the nominal plant."""

    servo_dead_time: NotNegative = 0.0  # [s] delay before a servo reacts to a new command
    servo_speed_limit: Positive | None = None  # [rad/s] slew rate of a servo; None: not observed
    inertia_tolerance: Annotated[float, Field(strict=True, ge=0.0, le=1.0)] = 0.15  # relative sd of the link inertia


Tolerance = Annotated[float, Field(strict=True, gt=0.0, le=0.65)]


class Tolerances(Record):
    """Relative standard deviations of the numbers in a device file; 5 % where the sources give none."""

    link_inertia: Tolerance = 0.05
    link_friction: Tolerance = 0.05  # viscous and Coulomb
    gravity: Tolerance = 0.05
    motor_inertia: Tolerance = 0.05
    motor_friction: Tolerance = 0.05  # viscous and Coulomb
    bandwidth: Tolerance = 0.05  # of servos
    spring: Tolerance = 0.05  # torque at a deflection
    damper: Tolerance = 0.05  # damping at a command
    kp: Tolerance = 0.05  # of a position drive: small where gains are known, large where they are to be identified
    kd: Tolerance = 0.05
    torque_limit: Tolerance = 0.05  # of a position drive
    # Of commanded and measured torques, such as a torque constant. No motion shows it, so it must be stated.
    torque_scale: Annotated[float, Field(strict=True, ge=0.0, le=0.65)] = 0.0
    # [s] of the delay of measured torques against the angles, late or early; 0: not stated.
    torque_timing: Annotated[float, Field(strict=True, ge=0.0, le=0.05)] = 0.0


class UnitColumn(Record):
    """A column of a recording: value = factor * number + offset, bit-exact for factor 1 and offset 0."""

    column: Text
    unit: Text | None = None  # e.g. deg, rpm, counts, A; None: SI, but for `scale`
    counts_per_turn: Positive | None = None  # of an encoder whose unit is counts
    torque_constant: Number | None = None  # [N m/A] at the joint: makes a torque of a current
    scale: Number = 1.0
    offset: Number = 0.0  # in the SI unit

    @cached_property
    def factor(self) -> float:
        """SI value of one unit of the column, times `scale`. Raises ParameterError with the remedy."""
        if self.unit is None:
            return self.scale
        return self.scale * factor(self.unit, self.counts_per_turn) * (self.torque_constant or 1.0)

    def in_si(self, numbers: Array) -> Array:
        """Values (N,) in SI of the numbers (N,) in the file."""
        scaled = numbers if self.factor == 1.0 else numbers * self.factor
        return scaled if self.offset == 0.0 else scaled + self.offset


class WireColumn(UnitColumn):
    """The column of a channel of a joint."""

    topic: Text | None = None  # of a bag: the topic with this column; needs the name `joint.member` of the column
    enable: Text | None = None  # another column: where it is 0, the value is NaN
    measured: bool = False  # of external_torque: not a command, so that its noise counts

    @model_validator(mode="before")
    @classmethod
    def _from_header(cls, entry: Any) -> Any:
        """A name alone is a column. A unit in brackets in its name counts, unless unit or scale are stated."""
        made = {"column": entry} if isinstance(entry, str) else entry
        if not isinstance(made, dict) or made.keys() & {"unit", "scale"} or not isinstance(made.get("column"), str):
            return made
        _, unit = split_unit(made["column"])
        return {**made, "unit": unit} if unit else made

    @property
    def turn(self) -> float:
        """[rad] of the channel for one turn of the encoder: `scale` is the gear where the unit is an angle."""
        return tau * (abs(self.scale) if self.unit else 1.0)

    def check_unit(self, channel: str) -> None:
        """Raise ValueError where there is no such channel, or the unit does not fit it."""
        units = {**UNITS, "time": "s", "motor": ""}
        if channel not in units and re.sub(r"_[12]$", "", channel) not in units:
            raise ValueError(f"columns.{channel}: no such channel; there are: {', '.join(sorted(units))}")
        if self.unit is None:
            return
        own = units.get(channel) or units.get(channel.rpartition("_")[0], "")  # of tau_1: that of tau
        try:
            _ = self.factor
            given, wanted = kind(self.unit), kind(own)
        except ParameterError as error:
            raise ValueError(f"columns.{channel}: {error}") from None
        if given == wanted or not wanted or (given == "" and self.scale != 1.0):
            return
        if wanted == "torque" and given == "current":
            if self.torque_constant is None:
                raise ValueError(f"columns.{channel}: unit '{self.unit}' needs torque_constant [N m/A] at the joint")
            return
        raise ValueError(f"columns.{channel}: '{self.unit}' is no unit of {wanted}; state the right unit, or a scale")


class Wire(Record):
    """Names in sensor_msgs/JointState, of topics and in recordings; empty ones are derived from the device name."""

    link: str = ""
    motors: tuple[str, ...] = ()
    command: str = ""
    # channel (time, q, theta_1, tau_1 ...) -> column of a recording
    columns: dict[str, WireColumn] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _units_fit(self) -> Wire:
        for channel, entry in self.columns.items():
            entry.check_unit(channel)
        return self

    @property
    def topics_of_columns(self) -> bool:
        """Whether a bag is read by the columns of its topics, and not by the names of the joints."""
        return any(entry.topic for entry in self.columns.values())
