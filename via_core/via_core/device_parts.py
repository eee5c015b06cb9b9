"""The entries of a device file: link, motors, springs, damper, sensors and names, each checked when it is read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import tau
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from via_core.dampers import DamperMap, LinearDamper, TwoStageDamper
from via_core.errors import ParameterError
from via_core.problems import NAME
from via_core.recordings.units import factor, kind
from via_core.signals import Array
from via_core.springs import (
    ExponentialSpring,
    FourBarSpring,
    MaccepaSpring,
    OddPolynomialSpring,
    SinhSpring,
    SpringLaw,
    TwoLeverSpring,
    cubic_spring,
    linear_spring,
)

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Text = Annotated[str, Field(min_length=1)]
LONGEST_DELAY = 0.1  # [s] of a drive, effects included: simulators keep as many commands


# What a channel measures: the kinds of `via_core.recordings.units`.
CHANNEL_KINDS = {
    "time": "time", "q": "angle", "theta": "angle", "q_velocity": "speed", "theta_velocity": "speed", "tau": "torque",
    "tau_link": "torque", "external_torque": "torque", "equilibrium": "angle", "preset": "angle",
}  # fmt: skip


class Record(BaseModel):
    """An immutable record, such as an entry of a file, that refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Described(Record):
    """What a file describes, where its numbers come from, and how reliable they are."""

    name: Annotated[str, Field(pattern=NAME)]
    title: Text
    source: Annotated[tuple[Text, ...], Field(min_length=1)]
    confidence: Literal["measured", "published", "identified", "copied", "assumed"]
    remark: str = ""


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


class _Built(Record):
    """An entry that describes an object of `make`, which checks the numbers against each other."""

    make: ClassVar[Callable[..., Any]]
    not_arguments: ClassVar[set[str]]  # keys that `make` does not take

    @property
    def built(self) -> Any:
        """The object that this entry describes. Raises ParameterError where its numbers are inconsistent."""
        return type(self).make(**self.model_dump(exclude=self.not_arguments))

    @model_validator(mode="after")
    def _builds(self) -> _Built:
        try:
            _ = self.built
        except ParameterError as error:
            raise ValueError(str(error)) from None
        return self


class _Spring(_Built):
    make: ClassVar[Callable[..., SpringLaw]]
    not_arguments = {"law"}
    max_deflection: Positive  # [rad] mechanical stop


class Linear(_Spring):
    make = staticmethod(linear_spring)
    law: Literal["linear"]
    stiffness: Positive  # [N m/rad]


class Cubic(_Spring):
    make = staticmethod(cubic_spring)
    law: Literal["cubic"]
    coefficient: Positive  # [N m/rad^3]


class OddPolynomial(_Spring):
    make = OddPolynomialSpring
    law: Literal["odd_polynomial"]
    odd_coefficients: tuple[Number, ...]  # [N m/rad^(2p+1)]


class Sinh(_Spring):
    make = SinhSpring
    law: Literal["sinh"]
    k: Positive  # [N m]
    a: Positive  # [1/rad]


class Exponential(_Spring):
    make = ExponentialSpring
    law: Literal["exponential"]
    k: Positive  # [N m]
    rise: Positive  # [-]
    fall: Positive  # [-]
    a: Positive  # [1/rad]


class FourBar(_Spring):
    make = FourBarSpring
    law: Literal["four_bar"]
    k: Positive  # [N m/rad]
    ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=1.0)]  # C [-]


class Maccepa(_Spring):
    make = MaccepaSpring
    law: Literal["maccepa"]
    k: Positive  # K [N/m]
    lever: Positive  # B [m]
    base: Positive  # C [m]
    free_length: Positive  # A0 [m]
    drum_radius: Positive  # r [m]


class TwoLever(_Spring):
    make = TwoLeverSpring
    law: Literal["two_lever"]
    k: Positive  # kappa [N/m]
    rest_length: Positive  # s0 [m]
    motor_lever: Positive  # L [m]
    link_lever: Positive  # a [m]
    offset: Number  # h [m]
    distance: Positive  # d [m]
    side: Literal[-1, 1]


Spring = Annotated[
    Linear | Cubic | OddPolynomial | Sinh | Exponential | FourBar | Maccepa | TwoLever, Field(discriminator="law")
]


class _Damper(_Built):
    make: ClassVar[Callable[..., DamperMap]]
    not_arguments = {"map", "site"}
    site: Literal["link", "transmission"]  # damping acts on qd, or on phid
    minimum: NotNegative = 0.0  # [N m s/rad] at command 0


class LinearDamping(_Damper):
    make = LinearDamper
    map: Literal["linear"]
    maximum: Positive  # [N m s/rad] at command 1


class TwoStageDamping(_Damper):
    make = TwoStageDamper
    map: Literal["two_stage"]
    stage: Positive  # [N m s/rad] added by the first half of the command
    second: NotNegative  # [-] fraction of `stage` added by the second half


Damping = Annotated[LinearDamping | TwoStageDamping, Field(discriminator="map")]


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


class WireColumn(Record):
    """A column of a recording in other units: value = scale * number * unit in SI + offset."""

    column: Text
    topic: Text | None = None  # of a bag: the topic with this column; needs the name `joint.member` of the column
    unit: Text | None = None  # e.g. deg, rpm, counts, A; None: SI, but for `scale`
    counts_per_turn: Positive | None = None  # of an encoder whose unit is counts
    torque_constant: Number | None = None  # [N m/A] at the joint: makes a torque of a current
    scale: Number = 1.0
    offset: Number = 0.0  # in the channel's unit
    enable: Text | None = None  # another column: where it is 0, the value is NaN
    measured: bool = False  # of external_torque: not a command, so that its noise counts

    @model_validator(mode="before")
    @classmethod
    def _from_header(cls, entry: Any) -> Any:
        return {"column": entry} if isinstance(entry, str) else entry

    @cached_property
    def factor(self) -> float:
        """SI value of one unit of the column. Raises ParameterError with the remedy."""
        if self.unit is None:
            return self.scale
        return self.scale * factor(self.unit, self.counts_per_turn) * (self.torque_constant or 1.0)

    @property
    def turn(self) -> float:
        """[rad] of the channel for one turn of the encoder: `scale` is the gear where the unit is an angle."""
        return tau * (abs(self.scale) if self.unit else 1.0)

    def check_unit(self, channel: str) -> None:
        """Raise ValueError where the unit does not fit the channel."""
        if self.unit is None:
            return
        try:
            _ = self.factor
            given, wanted = kind(self.unit), CHANNEL_KINDS.get(channel.rpartition("_")[0] or channel, "")
        except ParameterError as error:
            raise ValueError(f"columns.{channel}: {error}") from None
        wanted = CHANNEL_KINDS.get(channel, wanted)
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
    columns: dict[str, WireColumn] = {}  # channel (time, q, theta_1, tau_1 ...) -> column of a recording

    @model_validator(mode="after")
    def _units_fit(self) -> Wire:
        for channel, entry in self.columns.items():
            entry.check_unit(channel)
        return self

    @property
    def topics_of_columns(self) -> bool:
        """Whether a bag is read by the columns of its topics, and not by the names of the joints."""
        return any(entry.topic for entry in self.columns.values())
