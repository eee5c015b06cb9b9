"""Guesses of what the columns of a recording hold: time, and position, speed, torque or command of which joint.

The guess uses the words of a column's name (`elbow_pos_deg`, `tau[1]`, `Motor Current (mA)`), its unit if the name has
one, and its values: stamps increase, angles stay within a few turns, counts are integers. Every guess comes with its
reason, so that a person can check it in the file that is written.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from via_core.errors import SignalError
from via_core.recordings.tables import Tables, numbers
from via_core.recordings.unit_guess import (
    UnitGuess,
    are_alike,
    slope_of,
    unit_of_current,
    unit_of_position,
    unit_of_velocity,
)
from via_core.recordings.units import COUNTS, factor, is_unit, kind, split_unit
from via_core.signals import Array

if TYPE_CHECKING:
    from pandas import DataFrame

Quantity = Literal[
    "time", "position", "velocity", "torque", "current", "position command", "velocity command", "torque command",
    "feed-forward", "kp", "kd", "",
]  # fmt: skip
WORDS = {
    "time": {"time", "t", "stamp", "timestamp", "timestamps", "clock", "ts", "secs", "seconds", "zeit"},
    "position": {"position", "positions", "pos", "angle", "angles", "q", "qpos", "theta", "enc", "encoder", "phi"},
    "velocity": {"velocity", "velocities", "vel", "qd", "dq", "qvel", "speed", "omega", "qdot", "dtheta", "thetadot"},
    "torque": {
        "torque", "torques", "effort", "efforts", "eff", "tau", "trq", "moment", "force", "forces", "qfrc", "load",
    },
    "current": {"current", "currents", "cur", "curr", "i", "iq", "amp", "amps"},
    "command": {
        "command", "commands", "cmd", "commanded", "goal", "target", "desired", "des", "ref", "reference", "setpoint",
        "setpoints", "sp", "ctrl", "control", "u", "demand",
    },
    "feed-forward": {"ff", "tff", "feedforward", "forward"},
    "kp": {"kp"},
    "kd": {"kd"},
    "neither": {"error", "err", "acc", "acceleration", "accelerations", "qdd", "ddq", "temperature", "temp", "voltage"},
}  # fmt: skip
STAMPS = WORDS["time"] - {"t"}  # at the end of a name: the time of another signal, as `tau.time`
# Words that say what a signal is or where it is measured, not which joint it belongs to.
OF_ANY_JOINT = {
    "joint", "link", "axis", "motor", "drive", "actuator", "output", "input", "actual", "act", "measured", "meas",
    "raw", "filtered", "filt",
}.union(*WORDS.values())  # fmt: skip
COMMANDS: dict[str, Quantity] = {"torque": "torque command", "current": "", "velocity": "velocity command"}
MEASURED = ("position", "velocity", "torque", "current")
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m", "current": "A", "position command": "rad",
         "velocity command": "rad/s", "torque command": "N m", "feed-forward": "N m", "kp": "N m/rad",
         "kd": "N m s/rad"}  # fmt: skip
KINDS = {"position": "angle", "velocity": "speed", "torque": "torque", "current": "current"}
NOISE_ROWS = 20_000  # rows that guesses look at
# Units at the end of names without separators, as in `ElbowAngleDeg`.
JOINED = {"Deg": "deg", "Rad": "rad", "Nm": "N m", "Rpm": "rpm", "Dps": "dps", "Ms": "ms", "Us": "us", "Sec": "s"}


@dataclass(frozen=True)
class ColumnGuess:
    """What one column of a table holds.

    joint    name or number of the joint as text, '' if the name does not show it
    sure     whether the unit is written in the file or belongs to the message type
    instead  the unit that fits as well; '' if more than the size of the numbers shows the unit
    """

    table: str
    column: str
    quantity: Quantity
    joint: str
    unit: str
    sure: bool
    reason: str
    instead: str = ""


@dataclass(frozen=True)
class TimeGuess:
    """The time column of a table: its unit, the median rate [Hz], and what the rate is based on."""

    column: str
    unit: str
    rate: float
    reason: str


def guess_time(frame: DataFrame, bag: bool = False) -> TimeGuess | None:
    """The column of stamps; None if no column increases."""
    found = []
    for name in map(str, frame.columns):
        words, unit = split_name(name)
        named = bool(WORDS["time"] & set(words))
        try:
            values = numbers(frame, name)[:NOISE_ROWS]
        except SignalError:
            continue
        steps = np.diff(values[np.isfinite(values)])
        if len(steps) < 2 or np.mean(steps > 0.0) < (0.5 if named else 1.0):
            continue
        integers = not named and np.all(steps == 1.0)  # a row number
        found.append((named, not integers, -len(words), name, unit, float(np.median(steps[steps > 0.0]))))
    if not found:
        return None
    named, _, _, name, unit, step = max(found, key=lambda each: each[:3])
    if bag and name == "time":
        return TimeGuess(name, "ns", 1e9 / step, "stamps of the messages")
    if unit and kind(unit) == "time":
        reason = f"unit '{unit}' in its name"
    else:
        # Joints are logged at 5 Hz to 20 kHz, which fixes the unit except near the ends of that range.
        unit = "s" if step < 0.2 else "ms" if step < 200.0 else "us" if step < 2e5 else "ns"
        reason = f"{'named so' if named else 'the only column that increases'}; unit guessed from steps of {step:g}"
    scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    return TimeGuess(name, unit, 1.0 / (step * scale.get(unit, factor(unit))), reason)


def split_name(name: str) -> tuple[list[str], str]:
    """Words of a column's name in lower case, numbers included, and the unit in it: 'q1_deg' -> ['q', '1'], 'deg'."""
    name, unit = split_unit(name)
    if not unit:
        tail = re.search(r"_((?:[a-zA-Z]+_per_)?[A-Za-z]+)$", name)
        written = {"nm": "N m", "nmm": "N mm", "mnm": "mN m", "a": "A", "ma": "mA", "v": "V", "n": "N"}
        rate = re.search(r"_([A-Za-z]+)_s$", name)  # speed_deg_s, as names cannot hold a slash
        if rate and is_unit(rate[1]) and kind(rate[1]) == "angle":
            name, unit = name[: rate.start()], f"{rate[1]}/s"
        elif tail:
            text = tail[1].replace("_per_", "/")
            text = written.get(text.lower(), text)
            if (
                text.lower() not in WORDS["velocity"] | WORDS["current"] | {"t", "q", "u", "e", "m", "kd"}
                and is_unit(text)
                and (kind(text) or COUNTS.fullmatch(text))
            ):
                name, unit = name[: tail.start()], text
        else:
            joined = re.search(rf"(?<=[a-z0-9])({'|'.join(JOINED)})$", name)
            if joined:
                name, unit = name[: joined.start()], JOINED[joined[1]]
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name)]
    return words, unit


def guess_columns(
    tables: Tables,
    joints: Sequence[str] = (),
    limits: Mapping[str, tuple[float, float]] | None = None,
    bag: bool = False,
) -> list[ColumnGuess]:
    """Guesses for all columns but times, in order.

    joints  names of the robot's joints, base first: whole names in a column's name, else words of them that no other
            joint has, or numbers counted from 0 or 1
    limits  lowest and highest position [rad] of joints, infinite where they turn on and on; '' is the joint of columns
            without a name
    """
    found: list[ColumnGuess] = []
    everything = " ".join(_plain(str(name)) for frame in tables.values() for name in frame.columns)
    shortened = {joint: _words_of(joint) for joint in joints if _plain(joint) not in everything}
    for table, frame in tables.items():
        time = guess_time(frame, bag)
        own = [
            _by_name(table, str(name), joints, shortened, bag)
            for name in frame.columns
            if time is None or name != time.column
        ]
        for guess in own:
            if guess.quantity:
                try:
                    empty = not np.isfinite(numbers(frame, guess.column)[:NOISE_ROWS]).any()
                except SignalError:
                    guess = replace(guess, quantity="", reason="is not numeric")
                else:
                    guess = replace(guess, quantity="", reason="is empty") if empty else guess
            found.append(guess)
    return _with_units(_numbered(found if joints else _by_word(_by_path(found)), joints), tables, limits or {}, bag)


def _with_units(
    guesses: Sequence[ColumnGuess], tables: Tables, limits: Mapping[str, tuple[float, float]], bag: bool
) -> list[ColumnGuess]:
    """The guesses with units that fit the values, where names state none: positions first, then what refers to them."""
    found = list(guesses)
    for quantity in ("position", "velocity", "position command", "current"):
        for at, guess in enumerate(found):
            if guess.quantity == quantity and not guess.sure:
                own = _OfJoint(guess, [each for each in found if each.table == guess.table], tables, bag)
                seen = own.unit(limits.get(guess.joint))
                found[at] = replace(guess, unit=seen.unit, reason=seen.reason, instead=seen.instead)
    return found


@dataclass(frozen=True)
class _OfJoint:
    """A column without a unit, and the columns beside it."""

    guess: ColumnGuess
    beside: Sequence[ColumnGuess]
    tables: Tables
    bag: bool

    def unit(self, limits: tuple[float, float] | None) -> UnitGuess:
        """The unit of the column; `limits` of the position of its joint [rad]."""
        guess, position, velocity = self.guess, self._of("position"), self._of("velocity")
        if guess.quantity == "current":
            return unit_of_current(self._values(guess), guess.reason)
        if guess.quantity == "velocity":
            slope = None if position is None else self._slope(position, guess)
            return unit_of_velocity(guess.unit, guess.reason, None if position is None else position.unit, slope)
        if guess.quantity == "position":
            slope = None if velocity is None else self._slope(guess, velocity)
            stated = velocity.unit if velocity is not None and velocity.sure else ""
            return unit_of_position(self._values(guess), limits, slope, stated)
        if position is not None and are_alike(self._values(guess), self._values(position)):
            return UnitGuess(position.unit, f"as large as '{position.column}', so in its unit")
        return unit_of_position(self._values(guess), limits)

    def _of(self, quantity: Quantity) -> ColumnGuess | None:
        return next((e for e in self.beside if (e.joint, e.quantity) == (self.guess.joint, quantity)), None)

    def _values(self, guess: ColumnGuess) -> Array:
        return numbers(self.tables[guess.table], guess.column)[:NOISE_ROWS]

    def _slope(self, position: ColumnGuess, velocity: ColumnGuess) -> float | None:
        time = guess_time(self.tables[position.table], self.bag)
        if time is None:
            return None
        seconds = numbers(self.tables[position.table], time.column)[:NOISE_ROWS] * factor(time.unit)
        return slope_of(seconds, self._values(position), self._values(velocity), time.rate)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _words_of(joint: str) -> set[str]:
    """Words of a joint's name that can stand for it."""
    return {word for word in split_name(joint)[0] if not word.isdigit()} - OF_ANY_JOINT


def _by_name(
    table: str, column: str, joints: Sequence[str], shortened: Mapping[str, set[str]], bag: bool
) -> ColumnGuess:
    named = [joint for joint in sorted(joints, key=len, reverse=True) if _plain(joint) in _plain(column)]
    words, unit = split_name(column)
    if not named:
        common = {joint: of_joint & set(words) for joint, of_joint in shortened.items()}
        named = [
            joint
            for joint, shared in common.items()
            if shared and not any(shared <= _words_of(other) for other in joints if other != joint)
        ]
    if bag and "." in column:  # joint.member of a message
        joint, _, member = column.partition(".")
        named, words = [joint], split_name(member)[0]
    elif named:
        words = [word for word in words if word not in re.findall(r"[a-z]+|\d+", named[0].lower())] or words
    if bag:
        words += [w for w in split_name(table)[0] if w in WORDS["command"]]
    said = {what: bool(known & set(words)) for what, known in WORDS.items()}
    # Without a word, the unit shows the quantity.
    by_unit = (
        {"angle": "position", "speed": "velocity", "torque": "torque", "current": "current"}.get(kind(unit))
        if unit
        else None
    )
    if not any(said[each] for each in MEASURED) and by_unit:
        said[by_unit] = True
    quantity: Quantity = ""
    for each in ("velocity", "current", "torque", "position"):
        if said[each]:
            quantity = each
    if unit and quantity and kind(unit) and kind(unit) != KINDS[quantity] and by_unit:
        quantity = by_unit  # type: ignore[assignment]
    if quantity and unit and kind(unit) == "time":
        unit = ""  # the end of a name that looks like seconds is no unit of a signal
    gain: Quantity = "kp" if said["kp"] else "kd" if said["kd"] else ""
    if said["neither"] or (words and words[-1] in STAMPS):
        quantity = ""
    elif gain:
        quantity = "" if quantity else gain  # of a position loop alone: pos_kp
    elif said["feed-forward"]:
        quantity = "feed-forward" if quantity == "torque" or (not quantity and _of_torque(words)) else ""
    elif said["command"]:
        motion = "velocity" if quantity == "" and "v" in words else quantity  # p_des, v_des
        quantity = COMMANDS.get(motion, "position command")
    number = [word for word in words if word.isdigit()]
    joint = named[0] if named else number[-1] if number else ""
    sure = bool(unit) or (bag and "." in column)
    if quantity and not unit:
        unit = UNITS[quantity]
    reason = "by the message type" if bag and "." in column else "by its name" if quantity else "not used"
    return ColumnGuess(table, column, quantity, joint, unit, sure, reason)


def _of_torque(words: Sequence[str]) -> bool:
    """Whether the words of a feed-forward leave a torque, as `t_ff`: neither a speed, nor what is not known."""
    return all(word.isdigit() or word in {"t", *OF_ANY_JOINT} for word in words)


def _by_path(guesses: list[ColumnGuess]) -> list[ColumnGuess]:
    """The joint of names with parts, as `/joint_states/elbow/position`: the part that differs between like columns."""
    parts = [re.split(r"[/.]", guess.column) for guess in guesses]
    frames = [
        {(guess.table, guess.quantity, i, *part[:i], "", *part[i + 1 :]): part[i] for i in range(len(part))}
        for guess, part in zip(guesses, parts, strict=True)
    ]
    seen: dict[tuple[object, ...], set[str]] = {}
    for frame in frames:
        for key, part in frame.items():
            seen.setdefault(key, set()).add(part)
    made = []
    for guess, frame in zip(guesses, frames, strict=True):
        different = [part for key, part in frame.items() if len(seen[key]) > 1]
        named = guess.quantity and not guess.joint and len(frame) > 1 and len(different) == 1
        made.append(replace(guess, joint=different[0]) if named else guess)
    return made


def _by_word(guesses: list[ColumnGuess]) -> list[ColumnGuess]:
    """The joint of names without parts, as `elbow_pos`, `wrist_pos` and `wrist_tau`: the word that differs between
    positions, if a column of another quantity has it as well.
    """
    words: list[set[str]] = [set(split_name(guess.column)[0]) for guess in guesses]
    free = [own for own, guess in zip(words, guesses, strict=True) if guess.quantity == "position" and not guess.joint]
    different = [{word for word in own if not all(word in other for other in free)} for own in free]
    joints = set().union(*different)
    others = [own for own, guess in zip(words, guesses, strict=True) if guess.quantity not in ("position", "")]
    if len(free) < 2 or any(len(own) != 1 for own in different) or joints & OF_ANY_JOINT:
        return guesses
    if not joints & set().union(*others):
        return guesses
    found = []
    for guess, own in zip(guesses, words, strict=True):
        word, *more = own & joints or {""}
        written = re.search(word, guess.column, re.IGNORECASE)
        found.append(replace(guess, joint=written[0]) if written and not more and not guess.joint else guess)
    return found


def _numbered(guesses: list[ColumnGuess], joints: Sequence[str]) -> list[ColumnGuess]:
    """Numbers of joints in column names become names: counted from 0 if a number 0 is among them, else from 1.

    A number that all columns share shows no joint.
    """
    digits = {int(each.joint) for each in guesses if each.joint.isdigit() and each.quantity}
    if len(digits) == 1:
        return [replace(each, joint="") if each.joint.isdigit() else each for each in guesses]
    if not joints or not digits or max(digits) - (0 if 0 in digits else 1) >= len(joints):
        return guesses
    first = 0 if 0 in digits else 1
    return [replace(each, joint=joints[int(each.joint) - first]) if each.joint.isdigit() else each for each in guesses]


def of_joint(guesses: Sequence[ColumnGuess], joint: str = "") -> dict[Quantity, ColumnGuess]:
    """One column per quantity for a joint: columns with its name first, then those that name no joint.

    Raises SignalError where the recording has several joints and none of this name.
    """
    named = [each for each in guesses if each.quantity and each.joint == joint and joint]
    free = [each for each in guesses if each.quantity and not each.joint]
    others = sorted({each.joint for each in guesses if each.quantity == "position" and each.joint})
    if not named and not any(each.quantity == "position" for each in free):
        if len(others) == 1:
            named = [each for each in guesses if each.quantity and each.joint == others[0]]
        elif others:
            wanted = f"no joint '{joint}'" if joint else "several joints"
            raise SignalError(
                f"the recording has {wanted}; choose with --joint from: {', '.join(others)}; beside a model, with "
                "--log-joint"
            )
    chosen: dict[Quantity, ColumnGuess] = {}
    for each in (*named, *free):
        chosen.setdefault(each.quantity, each)
    return chosen
