"""Device files: one YAML per joint says what it is made of, where each number comes from and how far to trust it.

    device = load_device("maccepavd")            # a shipped file, see device_names()
    device = load_device("my_robot/joint.yaml")  # or your own

Every impossible value is refused here with one line that names file, key, value and allowed range, so that plants,
estimators and nodes may trust what they get.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from via_core.dampers import DamperMap, LinearDamper, TwoStageDamper
from via_core.errors import DeviceError, ParameterError
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
from via_core.wire import DRIVE, MOTOR, command_topic, link_name, motor_name

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Text = Annotated[str, Field(min_length=1)]

MOTORS = {"rigid": 0, "flexible": 1, "antagonistic": 2, "serial": 2}
SPRINGS = {"rigid": 0, "flexible": 1, "antagonistic": 2, "serial": 1}


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Link(_Part):
    """M qdd + Dq qd + Coulomb + sum tau_e + gravity_torque sin(q - gravity_angle) = tau_ext."""

    inertia: Positive  # M [kg m^2]
    viscous_friction: NotNegative  # Dq [N m s/rad]
    coulomb_friction: NotNegative = 0.0  # [N m]
    gravity_torque: Number = 0.0  # [N m] at the worst angle
    gravity_angle: Number = 0.0  # [rad] where the link hangs at rest


class TorqueMotor(_Part):
    """B thdd + Dth thd - tau_e(phi) = tau: a motor with dynamics of its own, commanded by torque."""

    inertia: Positive  # B [kg m^2], seen at the joint
    viscous_friction: NotNegative  # Dth [N m s/rad]
    coulomb_friction: NotNegative = 0.0  # [N m]
    torque_limit: Positive | None = None  # [N m], none known
    speed_limit: Positive | None = None  # [rad/s], none known


class ServoMotor(_Part):
    """A motor angle that follows its command as a critically damped second-order lag and is not driven back."""

    bandwidth: Positive  # w [rad/s]


class PositionDrive(_Part):
    """A drive on the link of a rigid joint that is commanded by a goal angle; no motor angle and no torque is measured.

        tau = clip(kp (goal - q), -torque_limit, torque_limit) - kd qd

    with the goal as it was commanded `delay` ago. A goal of NaN switches the drive off: it gives no torque at all, and
    only friction is left. Of a DC servo with supply voltage V, torque constant kt and resistance R (both seen at the
    joint) whose duty cycle is proportional to the error: kp = kt V/R times duty per error, torque_limit = kt V/R (full
    duty), kd = kt^2/R (back electromotive force).
    """

    kp: Positive  # [N m/rad]
    kd: NotNegative  # [N m s/rad]
    torque_limit: Positive | None = None  # [N m], none known
    speed_limit: Positive | None = None  # [rad/s] at most so fast the drive's own goal follows the command, none known
    delay: Annotated[float, Field(strict=True, ge=0.0, le=0.1)] = 0.0  # [s] dead time of the goal


def _motor_kind(motor: Any) -> str:
    has = motor.keys() if isinstance(motor, dict) else vars(motor).keys() if isinstance(motor, BaseModel) else ()
    return "servo" if "bandwidth" in has else "torque"


Motor = Annotated[
    Annotated[TorqueMotor, Tag("torque")] | Annotated[ServoMotor, Tag("servo")], Discriminator(_motor_kind)
]


class _Law(_Part):
    """An entry whose numbers must also fit one another: it is refused unless it builds."""

    @property
    def built(self) -> SpringLaw | DamperMap:
        """What this entry describes; raises ParameterError where its numbers do not fit one another."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _builds(self) -> _Law:
        try:
            _ = self.built
        except ParameterError as error:
            raise ValueError(str(error)) from None
        return self


class _Spring(_Law):
    max_deflection: Positive  # [rad] mechanical stop


class Linear(_Spring):
    law: Literal["linear"]
    stiffness: Positive  # [N m/rad]

    @property
    def built(self) -> SpringLaw:
        return linear_spring(self.stiffness, self.max_deflection)


class Cubic(_Spring):
    law: Literal["cubic"]
    coefficient: Positive  # [N m/rad^3]

    @property
    def built(self) -> SpringLaw:
        return cubic_spring(self.coefficient, self.max_deflection)


class OddPolynomial(_Spring):
    law: Literal["odd_polynomial"]
    odd_coefficients: tuple[Number, ...]  # [N m/rad^(2p+1)]

    @property
    def built(self) -> SpringLaw:
        return OddPolynomialSpring(self.max_deflection, self.odd_coefficients)


class Sinh(_Spring):
    law: Literal["sinh"]
    k: Positive  # [N m]
    a: Positive  # [1/rad]

    @property
    def built(self) -> SpringLaw:
        return SinhSpring(self.max_deflection, self.k, self.a)


class Exponential(_Spring):
    law: Literal["exponential"]
    k: Positive  # [N m]
    rise: Positive  # [-]
    fall: Positive  # [-]
    a: Positive  # [1/rad]

    @property
    def built(self) -> SpringLaw:
        return ExponentialSpring(self.max_deflection, self.k, self.rise, self.fall, self.a)


class FourBar(_Spring):
    law: Literal["four_bar"]
    k: Positive  # [N m/rad]
    ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=1.0)]  # C [-]

    @property
    def built(self) -> SpringLaw:
        return FourBarSpring(self.max_deflection, self.k, self.ratio)


class Maccepa(_Spring):
    law: Literal["maccepa"]
    k: Positive  # K [N/m]
    lever: Positive  # B [m]
    base: Positive  # C [m]
    free_length: Positive  # A0 [m]
    drum_radius: Positive  # r [m]

    @property
    def built(self) -> SpringLaw:
        return MaccepaSpring(self.max_deflection, self.k, self.lever, self.base, self.free_length, self.drum_radius)


class TwoLever(_Spring):
    law: Literal["two_lever"]
    k: Positive  # kappa [N/m]
    rest_length: Positive  # s0 [m]
    motor_lever: Positive  # L [m]
    link_lever: Positive  # a [m]
    offset: Number  # h [m]
    distance: Positive  # d [m]
    side: Literal[-1, 1]

    @property
    def built(self) -> SpringLaw:
        return TwoLeverSpring(
            self.max_deflection,
            self.k,
            self.rest_length,
            self.motor_lever,
            self.link_lever,
            self.offset,
            self.distance,
            float(self.side),
        )


Spring = Annotated[
    Linear | Cubic | OddPolynomial | Sinh | Exponential | FourBar | Maccepa | TwoLever, Field(discriminator="law")
]


class _Damper(_Law):
    site: Literal["link", "transmission"]  # acts on qd, or on phid
    minimum: NotNegative = 0.0  # [N m s/rad] at command 0


class LinearDamping(_Damper):
    map: Literal["linear"]
    maximum: Positive  # [N m s/rad] at command 1

    @property
    def built(self) -> DamperMap:
        return LinearDamper(self.minimum, self.maximum)


class TwoStageDamping(_Damper):
    map: Literal["two_stage"]
    stage: Positive  # [N m s/rad] added by the first half of the command
    second: NotNegative  # [-] share of `stage` added by the second half

    @property
    def built(self) -> DamperMap:
        return TwoStageDamper(self.minimum, self.stage, self.second)


Damping = Annotated[LinearDamping | TwoStageDamping, Field(discriminator="map")]


class Sensors(_Part):
    """What the device measures with; a quantum left out means 'ideal', never 0."""

    rate: Positive  # [Hz]
    link_quantum: Positive | None = None  # [rad] encoder step at the link
    motor_quantum: Positive | None = None  # [rad] encoder step at the motors
    torque_noise: NotNegative = 0.0  # [N m] standard deviation of the motor torque measurement
    link_torque_noise: NotNegative | None = None  # [N m] the same of a torque sensor at the link; none if left out


class Observed(_Part):
    """What this device's own logs show beside its published model: estimators use it, the nominal plant does not."""

    servo_dead_time: NotNegative = 0.0  # [s] a servo stands still after its command changed
    servo_speed_limit: Positive | None = None  # [rad/s] fastest a servo slews, none seen
    inertia_tolerance: Annotated[float, Field(strict=True, ge=0.0, le=1.0)] = 0.15  # relative sd of the link's inertia


Tolerance = Annotated[float, Field(strict=True, gt=0.0, le=0.65)]


class Tolerances(_Part):
    """How well the numbers of a file are known: relative standard deviations, 5 % where the sources say no more."""

    link_inertia: Tolerance = 0.05
    link_friction: Tolerance = 0.05  # viscous and dry
    gravity: Tolerance = 0.05
    motor_inertia: Tolerance = 0.05
    motor_friction: Tolerance = 0.05  # viscous and dry
    bandwidth: Tolerance = 0.05  # of servos
    spring: Tolerance = 0.05  # torque at a deflection
    damper: Tolerance = 0.05  # damping at a command
    kp: Tolerance = 0.05  # of a position drive: small where gains are known, large where they are to be fitted
    kd: Tolerance = 0.05
    torque_limit: Tolerance = 0.05  # of a position drive


class WireColumn(_Part):
    """A column of a foreign CSV file in other units: value = scale times the number in the file + offset."""

    column: Text
    scale: Number = 1.0
    offset: Number = 0.0  # in the channel's unit
    enable: Text | None = None  # another column: where it is 0 the value counts as NaN

    @model_validator(mode="before")
    @classmethod
    def _of_header(cls, entry: Any) -> Any:
        return {"column": entry} if isinstance(entry, str) else entry


class Wire(_Part):
    """Names in sensor_msgs/JointState, on topics and in CSV files; empty ones follow from the device's name."""

    link: str = ""
    motors: tuple[str, ...] = ()
    command: str = ""
    columns: dict[str, WireColumn] = {}  # channel (time, q, theta_1, tau_1 ...) -> column of a foreign CSV file


class Device(_Part):
    """One joint with its actuator, as its file describes it."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    title: Text
    source: Annotated[tuple[Text, ...], Field(min_length=1)]
    confidence: Literal["measured", "published", "identified", "copied", "assumed"]
    remark: str = ""
    arrangement: Literal["rigid", "flexible", "antagonistic", "serial"]
    drive: Literal["torque", "servo", "position"] = "torque"
    link: Link
    servo: PositionDrive | None = None
    motors: tuple[Motor, ...] = ()
    springs: tuple[Spring, ...] = ()
    damper: Damping | None = None
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
            if _motor_kind(motor) != self.drive:
                raise ValueError(f"motors.{i}: drive is '{self.drive}' but this is a {_motor_kind(motor)} motor")
        if self.damper is not None and self.damper.site == "transmission" and not self.springs:
            raise ValueError("damper.site: 'transmission' needs a transmission, and a rigid joint has none")
        if len(self.wire.motors) not in (0, self.n_drives):
            raise ValueError(f"wire.motors: needs 0 or {self.n_drives} names, got {len(self.wire.motors)}")
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Device:
        """As pydantic has it, but nothing built of the old numbers goes along."""
        copied = super().model_copy(update=update, deep=deep)
        for built in ("spring_laws", "damper_map"):
            copied.__dict__.pop(built, None)
        return copied

    @property
    def n_motors(self) -> int:
        return len(self.motors)

    @property
    def n_transmissions(self) -> int:
        return len(self.springs)

    @cached_property
    def spring_laws(self) -> tuple[SpringLaw, ...]:
        """One law per transmission."""
        return tuple(spring.built for spring in self.springs)

    @cached_property
    def damper_map(self) -> DamperMap | None:
        """The map from damping command to damping, or None for a device without damper."""
        return None if self.damper is None else self.damper.built

    def damping_of(self, u: ArrayLike) -> Array:
        """Damping [N m s/rad] that the damper adds at command u [-]; zero for a device without one."""
        return np.zeros(np.shape(u)) if self.damper_map is None else self.damper_map.value(u)

    @property
    def link_joint(self) -> str:
        """Name of the link in sensor_msgs/JointState."""
        return self.wire.link or link_name(self.name)

    @property
    def n_drives(self) -> int:
        """Drives whose torque is on the wire: one per motor; of a rigid joint the one that acts on its link."""
        return self.n_motors or 1

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Names in sensor_msgs/JointState whose effort is a drive's torque: the motors, or a rigid joint's drive."""
        return self.wire.motors or tuple(motor_name(self.name, i) for i in range(1, self.n_drives + 1))

    @property
    def drive_channels(self) -> dict[str, str]:
        """Channel -> array of a JointState of what stands there: of a rigid joint's drive its torque only."""
        return MOTOR if self.n_motors else DRIVE

    @property
    def motor_joints(self) -> tuple[str, ...]:
        """Names of the motors in sensor_msgs/JointState."""
        return self.drive_joints[: self.n_motors]

    @property
    def command_topic(self) -> str:
        return self.wire.command or command_topic(self.name)

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
        """Total device stiffness (...) [N m/rad] by this device's laws, eq. (7).

        q       (...) link angle [rad]
        theta   (..., m) motor angles [rad]
        preset  (...) angle of the preset motor of a serial device [rad]; without it the second column of theta counts
        """
        return self._each("stiffness", q, theta, preset).sum(axis=-1)

    def _each(self, what: str, q: ArrayLike, theta: ArrayLike, preset: ArrayLike | None) -> Array:
        link, motor = np.asarray(q, dtype=np.float64), np.asarray(theta, dtype=np.float64)
        if motor.shape[-1:] != (self.n_motors,):
            raise ParameterError(f"theta must end in ({self.n_motors},) for '{self.name}', got shape {motor.shape}")
        values = []
        for i, law in enumerate(self.spring_laws):
            own = motor[..., i]  # antagonistic laws may depend on their own motor's angle beside the deflection
            if self.arrangement == "serial":
                own = motor[..., 1] if preset is None else np.asarray(preset, dtype=np.float64)
            values.append(getattr(law, what)(link - motor[..., i], own))
        return np.stack(values, axis=-1) if values else np.zeros((*link.shape, 0))


class _Loader(yaml.SafeLoader):
    """safe_load that refuses duplicate keys and reads 1e-4 as a number (YAML 1.1 takes it for text)."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    "", node.start_mark, f"duplicate key '{key}'", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(?:\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def device_names() -> tuple[str, ...]:
    """Names of the shipped devices, sorted."""
    folder = resources.files("via_core").joinpath("devices")
    return tuple(sorted(file.name.removesuffix(".yaml") for file in folder.iterdir() if file.name.endswith(".yaml")))


def load_device(name_or_path: str | Path) -> Device:
    """The shipped device of that name, or the one a YAML file describes.

    'elbow=qbmove_a' is that device under another name, and so with other joints and topics: one file for all joints of
    an arm. Names that the file itself maps stay.
    Raises DeviceError: no such device, unreadable file, bad YAML, or a key or value outside what a device can be.
    """
    renamed = re.fullmatch(r"([a-z][a-z0-9_]*)=(.+)", name_or_path) if isinstance(name_or_path, str) else None
    if renamed:
        return load_device(renamed[2]).model_copy(update={"name": renamed[1]})
    if isinstance(name_or_path, Path) or re.search(r"[/\\]|\.ya?ml$", name_or_path):
        where, shown = Path(name_or_path), str(name_or_path)
    else:
        names = device_names()
        if name_or_path not in names:
            raise DeviceError(f"no device '{name_or_path}'; there are: {', '.join(names)}")
        shown = f"{name_or_path}.yaml"
        where = Path(str(resources.files("via_core").joinpath("devices", shown)))
    try:
        text = where.read_text(encoding="utf-8")
    except OSError as error:
        raise DeviceError(f"{shown}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DeviceError(f"{shown}: cannot be read: not UTF-8 text") from None
    except ValueError as error:  # a path with a null byte
        raise DeviceError(f"{shown!r}: cannot be read: {error}") from None
    return parse_device(text, shown)


def parse_device(text: str, file: str) -> Device:
    """The device that YAML `text` describes; `file` is the name that errors show. Raises DeviceError."""
    try:
        content = yaml.load(text, _Loader)  # a SafeLoader
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark is not None else ""
        what = getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML"
        raise DeviceError(_one_line(f"{file}:{line} {what}")) from None
    except (TypeError, ValueError, RecursionError) as error:
        raise DeviceError(_one_line(f"{file}: not YAML: {error}")) from None
    if not isinstance(content, dict):
        raise DeviceError(f"{file}: a device file is a mapping of keys, got {type(content).__name__}")
    try:
        return Device.model_validate(content)
    except ValidationError as error:
        raise DeviceError(_one_line(f"{file}: {'; '.join(_told(p) for p in error.errors())}")) from None


def _one_line(text: str) -> str:
    """A key or a value of the file may hold line breaks; the error may not."""
    return " ".join(text.splitlines())


# Pydantic puts the tag of a union into the path; none of these is a key.
_TAGS = {
    *("torque", "servo", "linear", "two_stage"),
    *("cubic", "odd_polynomial", "sinh", "exponential", "four_bar", "maccepa", "two_lever"),
}


def _told(problem: Any) -> str:
    """One pydantic problem as 'dotted.key: what is allowed, got value'."""
    key = ".".join(str(part) for i, part in enumerate(problem["loc"]) if i == 0 or part not in _TAGS)
    text = problem["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if problem["type"] == "missing":
        return f"{key}: is missing"
    if problem["type"] == "union_tag_not_found":
        return f"{key}.{problem['ctx']['discriminator'].strip(chr(39))}: is missing"
    if problem["type"] == "union_tag_invalid":
        context = problem["ctx"]
        which = context["discriminator"].strip("'")
        return f"{key}.{which}: must be one of {context['expected_tags']}, got '{context['tag']}'"
    if problem["type"] == "extra_forbidden":
        return f"{key}: is no known key"
    if problem["type"] == "value_error":
        return f"{key}: {text}" if key else text
    value = repr(problem["input"])
    return f"{key}: {text}, got {value if len(value) <= 80 else value[:77] + '...'}"
