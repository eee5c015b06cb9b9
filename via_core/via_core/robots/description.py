"""A device file that states the origin (read, measured, guessed) and the tolerance of every number."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from via_core.device_parts import LONGEST_DELAY
from via_core.robots.models import Robot, RobotJoint

Origin = Literal["read", "measured", "guessed", "stated"]
# Relative standard deviations. CAD masses and lengths are good to some percent; friction of a description is seldom
# measured, and changes with load and temperature; guesses are known to a factor of about two.
CAD, WITHOUT_ROTOR, FRICTION, GUESS = 0.05, 0.2, 0.3, 0.65
TORQUE = 0.05  # of torques: constants of motors vary between copies by some percent, and fall as magnets warm
NO_SINE = 0.02  # difference of a gravity from a sine, relative to its size, that gets a remark
RATE = 500.0  # [Hz] where no recording shows one
ORDER = ("inertia", "viscous_friction", "coulomb_friction", "gravity_torque", "gravity_angle", "kp", "kd", "ki",
         "integral_limit", "torque_limit", "speed_limit", "delay", "rate", "link_quantum", "torque_noise")  # fmt: skip
PARTS = {
    "servo": ("kp", "kd", "ki", "integral_limit", "torque_limit", "speed_limit", "delay"),
    "sensors": ("rate", "link_quantum", "torque_noise"),
}
UNITS = {
    "inertia": "kg m^2", "viscous_friction": "N m s/rad", "coulomb_friction": "N m", "gravity_torque": "N m",
    "gravity_angle": "rad", "kp": "N m/rad", "kd": "N m s/rad", "ki": "N m/(rad s)",
    "integral_limit": "N m", "torque_limit": "N m", "speed_limit": "rad/s", "delay": "s", "torque_scale": "-",
    "rate": "Hz", "link_quantum": "rad", "torque_noise": "N m",
}  # fmt: skip
LINEAR = {
    "kg m^2": "kg", "N m s/rad": "N s/m", "N m/rad": "N/m", "N m/(rad s)": "N/(m s)", "N m": "N", "rad": "m",
    "rad/s": "m/s",
}  # fmt: skip
# The tolerance of the device file that covers a number.
TOLERANCE = {
    "inertia": "link_inertia", "viscous_friction": "link_friction", "coulomb_friction": "link_friction",
    "gravity_torque": "gravity", "torque_scale": "torque_scale", "kp": "kp", "kd": "kd",
    "torque_limit": "torque_limit",
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One number of a device file: its origin, why, and its relative standard deviation."""

    value: float
    origin: Origin
    note: str
    tolerance: float | None = None


@dataclass
class Description:
    """Everything that a device file of a rigid joint states, filled step by step."""

    name: str
    joint: str  # in messages and models
    command: str  # that writes the file
    drive: Literal["torque", "position"] = "torque"
    limited: Literal["sum", "proportional"] = "proportional"  # what the torque limit of a position drive limits
    linear: bool = False
    confidence: str = "assumed"
    sources: list[str] = field(default_factory=list)
    numbers: dict[str, Number] = field(default_factory=dict)
    columns: dict[str, tuple[dict[str, Any], str]] = field(default_factory=dict)  # channel -> entry, and why
    remarks: list[str] = field(default_factory=list)

    def unit(self, number: str) -> str:
        return LINEAR.get(UNITS[number], UNITS[number]) if self.linear else UNITS[number]

    def text(self) -> str:
        """The commented device file."""
        out = [
            f"# Written by `{self.command}`.",
            "# Each number was read from the model, measured in the log, stated by you, or guessed. Its tolerance is",
            "# a relative standard deviation, which `tolerances` repeats. Correct what you know better.",
            *(["# The joint slides: m, N, kg stand in the places of rad, N m, kg m^2."] if self.linear else []),
            *(f"# {line}" for remark in self.remarks for line in _wrapped(remark)),
            f"name: {self.name}",
            f"title: Joint {_quoted(self.joint)}" if _plain(self.joint) else f"title: {_quoted('Joint ' + self.joint)}",
            "source:",
            *(f"  - {_quoted(each)}" for each in self.sources or ["guesses"]),
            f"confidence: {self.confidence}",
            "arrangement: rigid",
            f"drive: {self.drive}",
            *([self._line("torque_scale").strip()] if "torque_scale" in self.numbers else []),
        ]
        for part in ("link", "servo", "sensors"):
            inside = [
                n
                for n in ORDER
                if n in self.numbers
                and (n in PARTS.get(part, ()) or (part == "link" and not any(n in p for p in PARTS.values())))
            ]
            if inside:
                out.append(f"{part}:")
                out += [self._line(each) for each in inside]
                if part == "servo" and "torque_limit" in inside and self.limited == "sum":
                    out.append("  limited: sum  # read: the actuator's limit includes its damping")
        tolerances: dict[str, float] = {}
        for name, number in self.numbers.items():
            if number.tolerance is not None and name in TOLERANCE and number.value != 0.0:
                key = TOLERANCE[name]
                tolerances[key] = max(tolerances.get(key, 0.0), number.tolerance)
        if tolerances:
            out += ["tolerances:", *(f"  {key}: {value:g}" for key, value in tolerances.items())]
        out += [
            "wire:",
            f"  link: {_quoted(self.joint)}  # name in JointState messages",
            f"  motors: [{_quoted(self.joint)}]  # the effort of the same name is the drive's",
        ]
        if self.columns:
            out += ["  columns:  # of recordings"]
            out += [f"    {channel}: {_flow(entry)}  # {why}" for channel, (entry, why) in self.columns.items()]
        return "\n".join(out) + "\n"

    def _line(self, name: str) -> str:
        number = self.numbers[name]
        about = f"; tolerance {number.tolerance:.0%}" if number.tolerance is not None and number.value != 0.0 else ""
        return f"  {name}: {_number(number.value)}  # [{self.unit(name)}] {number.origin}: {number.note}{about}"


def of_model(description: Description, robot: Robot, joint: RobotJoint, at: Mapping[str, float]) -> None:
    """Fill in what a robot's model states about a joint, with the other joints at the angles `at` [rad]."""
    seen, numbers = robot.seen_at(joint.name, at), description.numbers
    description.linear = joint.kind == "prismatic"
    description.sources.append(robot.file)
    description.confidence = "copied"
    pose = _pose(robot, joint, at)
    rotor = joint.armature or 0.0
    inertia = seen.inertia + rotor
    between = (
        ""
        if np.isclose(seen.lowest, seen.highest, rtol=1e-3)
        else f" ({seen.lowest + rotor:.3g} to {seen.highest + rotor:.3g} over all poses)"
    )
    included = f", rotor {rotor:.3g} included" if rotor else "; the model states no rotor inertia"
    if inertia > 1e-12:
        numbers["inertia"] = Number(
            inertia,
            "read",
            f"of all bodies that it moves, with {pose}{between}{included}",
            CAD if rotor else WITHOUT_ROTOR,
        )
    else:
        numbers["inertia"] = Number(1e-3, "guessed", "the model states no mass beyond this joint", GUESS)
        description.remarks.append("the inertia is a guess: state <inertial> of the links that the joint moves")
    _friction(description, "viscous_friction", joint.damping, "damping")
    _friction(description, "coulomb_friction", joint.friction, "friction")
    if not description.linear:
        numbers["gravity_torque"] = Number(seen.gravity_torque, "read", f"largest, with {pose}", CAD)
        numbers["gravity_angle"] = Number(seen.gravity_angle, "read", "angle at which the link hangs at rest")
    elif abs(seen.gravity_torque) > 1e-9:
        description.remarks.append(
            f"gravity acts along the axis with a constant {-seen.gravity_torque:.4g} N, which no entry can state: "
            f"write `offset: {-seen.gravity_torque:.4g}` to the column of the force"
        )
    if seen.gravity_error > NO_SINE * max(abs(seen.gravity_torque), 1e-6):
        description.remarks.append(
            f"the gravity of the joints that follow it is no {'constant' if description.linear else 'sine'}: the "
            f"stated one is wrong by up to {seen.gravity_error:.3g} {description.unit('gravity_torque')}"
        )
    _drive(description, joint)
    limits = [
        f"{what} {value:g} {unit}"
        for what, value, unit in (
            ("effort", joint.effort, description.unit("torque_limit")),
            ("speed", joint.speed, description.unit("speed_limit")),
        )
        if value and not (what == "effort" and "torque_limit" in numbers)
    ]
    if np.isfinite(joint.low) and np.isfinite(joint.high):
        limits.append(f"{joint.low:g} to {joint.high:g} {description.unit('gravity_angle')}")
    if limits:
        description.remarks.append(
            f"limits read: {', '.join(limits)}; a rigid joint with a torque drive has no entry for them"
        )
    description.remarks += [*robot.remarks, *joint.remarks]


def rigid_springs(robot: Robot, joint: str) -> list[str]:
    """Remarks on the springs in joints that a joint moves, which the description of it alone takes as rigid."""
    units = {"revolute": "N m/rad", "prismatic": "N/m"}
    return [
        f"joint {each.name}, which it moves, has a spring of {each.stiffness:g} {units[each.kind]}: taken as rigid; "
        "describe a drive with a spring behind it as `arrangement: flexible`"
        for each in robot.sprung(joint)
    ]


def _pose(robot: Robot, joint: RobotJoint, at: Mapping[str, float]) -> str:
    """The pose of the other joints in words; the zero pose of a model's bodies can have joints at other angles."""
    stated = [f"{name} at {value:g}" for name, value in at.items()]
    drawn = [
        f"{each.name} at {each.reference:.4g}"
        for each in robot.joints
        if each.reference and each.name not in (joint.name, *at)
    ]
    rest = f"{'the' if stated else 'all'} other joints at their zero"
    if drawn:
        rest = f"{'the' if stated else 'all'} other joints as the model draws them ({', '.join(drawn)}, else 0)"
    return ", ".join([*stated, rest])


def _drive(description: Description, joint: RobotJoint) -> None:
    """The drive of a joint: gains and limits of a position drive, and remarks on units of commands and on bias."""
    numbers, unit = description.numbers, description.unit("torque_limit")
    if joint.kp is not None:
        description.drive, description.limited = "position", joint.limited
        gear = "" if joint.gear == 1.0 else f", gear {joint.gear:g} squared included"
        numbers["kp"] = Number(joint.kp, "read", f"of the position actuator{gear}", CAD)
        numbers["kd"] = Number(joint.kd or 0.0, "read", f"kv or damping of its actuators{gear}", CAD)
        if joint.gear != 1.0:
            description.remarks.append(
                f"its actuator has gear {joint.gear:g}: goals in its units need `scale: {1 / joint.gear:g}`"
            )
        if joint.ki:
            numbers["ki"] = Number(joint.ki, "read", f"of the actuator{gear}")
        if joint.integral_limit:
            numbers["integral_limit"] = Number(joint.integral_limit, "read", "ki times imax of the actuator")
        if joint.slew:
            numbers["speed_limit"] = Number(joint.slew, "read", "slewmax of the actuator")
        if joint.effort:
            numbers["torque_limit"] = Number(joint.effort, "read", "force range of the actuator", CAD)
        if joint.delay:
            beyond = joint.delay > LONGEST_DELAY
            longest = f"longest that a device file can state; the actuator has {joint.delay:g} s"
            numbers["delay"] = Number(
                min(joint.delay, LONGEST_DELAY),
                "guessed" if beyond else "read",
                longest if beyond else "of the actuator",
            )
        where = f"`offset: {joint.bias / joint.kp:.4g}` to the column of goals"
    else:
        if joint.gear not in (0.0, 1.0):
            description.remarks.append(
                f"its actuator makes {joint.gear:g} {unit} of a command of 1 (gear times gain): torques in its units "
                f"need `scale: {joint.gear:g}`"
            )
        if joint.delay:
            description.remarks.append(
                f"delay {joint.delay:g} s of its actuator: not used, a torque drive has no entry for it; an effects "
                "file can have one, actuator_delay"
            )
        where = f"`offset: {joint.bias:.4g}` to the column of torques, or an effect torque_bias"
    if joint.bias:
        description.remarks.append(f"its actuator adds a constant {joint.bias:.4g} {unit}: not used; write {where}")


def _friction(description: Description, name: str, value: float | None, word: str) -> None:
    if value is not None and value > 0.0:
        description.numbers[name] = Number(value, "read", f"{word} of the joint", FRICTION)
    elif value is not None:
        description.numbers[name] = Number(0.0, "read", f"the model states a {word} of 0")
    else:
        description.numbers[name] = Number(0.0, "guessed", f"the model states no {word}; a diagnosis finds it")


def guess_gains(description: Description) -> None:
    """Gains of a position drive whose model states none: 5 Hz of bandwidth, damping ratio .7 with its inertia."""
    inertia, w = description.numbers["inertia"].value, 2.0 * np.pi * 5.0
    note = "5 Hz of bandwidth"
    description.numbers["kp"] = Number(inertia * w**2, "guessed", note, GUESS)
    description.numbers["kd"] = Number(1.4 * inertia * w, "guessed", "damping ratio .7 at that bandwidth", GUESS)


def device_name(joint: str) -> str:
    """A joint's name as the name of a device: lower case, letters, digits and underscores."""
    name = re.sub(r"[^a-z0-9]+", "_", joint.lower()).strip("_")
    return name if re.match(r"[a-z]", name) else f"joint_{name}".rstrip("_")


def _number(value: float) -> str:
    return f"{value:.6g}" if value else "0.0"


def _plain(text: str) -> bool:
    return re.fullmatch(r"[A-Za-z_][\w/. -]*", text) is not None


def _quoted(text: str) -> str:
    """A text as YAML on one line."""
    if _plain(text) and text.lower() not in ("y", "n", "yes", "no", "on", "off", "true", "false", "null"):
        return text
    return "'" + " ".join(text.split()).replace("'", "''") + "'"


def _flow(entry: Mapping[str, Any]) -> str:
    if set(entry) == {"column"}:
        return _quoted(entry["column"])
    return (
        "{"
        + ", ".join(
            f"{key}: {_quoted(value) if isinstance(value, str) else _number(value)}" for key, value in entry.items()
        )
        + "}"
    )


def _wrapped(remark: str) -> list[str]:
    text = " ".join(f"Note: {remark}.".split())
    return textwrap.wrap(text, 116, subsequent_indent=" ", break_long_words=False, break_on_hyphens=False)
