"""Devices of a lab's robot: from its model (URDF, MJCF), from a recording of any format, or from both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from via_core.device_parts import WireColumn
from via_core.devices import parse_device
from via_core.errors import SignalError
from via_core.recordings.channels import joint_of
from via_core.recordings.entries import Constants, entries_of, linear
from via_core.recordings.guess import ColumnGuess, guess_columns
from via_core.recordings.tables import Tables, is_bag, numbers, read_tables
from via_core.recordings.unnamed import require_names
from via_core.robots.description import (
    GUESS,
    RATE,
    Description,
    Number,
    device_name,
    guess_gains,
    of_model,
    rigid_springs,
)

from via_gap.logs.log import JointLog
from via_gap.logs.survey import fit_gains, fit_joint, survey

if TYPE_CHECKING:
    from via_core.robots.models import Robot, RobotJoint

DRIVEN = ("torque", "current", "torque command")
BEYOND = 0.1  # of the largest limit of a joint, by which recorded positions may be beyond the limits
EXACT = 1e-6  # of the largest torque: less noise means that the torque was computed


def describe(
    command: str,
    model: Path | None,
    joint: str,
    log: Path | None,
    at: Mapping[str, float],
    constants: Constants,
) -> Description:
    """The description of one joint. Raises ViaError with the remedy where the joint or its numbers cannot be found.

    command  that writes the file, for its first line
    at       angles [rad] of other joints, which the inertia of the joint depends on
    """
    robot = None
    if model is not None:
        from via_core.robots.models import read_robot  # imports pinocchio

        robot = read_robot(model)
        joint = robot.joint(joint if joint or len(robot.joints) != 1 else robot.joints[0].name).name
    recorded = None if log is None else Recorded.of(log, robot, joint, constants.joint)
    made = described(command, robot, joint, recorded, at, constants)
    if robot is not None:
        made.remarks += rigid_springs(robot, joint)
        made.remarks += [] if recorded is None else _others(robot, joint, recorded)
    return made


@dataclass(frozen=True)
class Recorded:
    """A recording with the guesses of its columns."""

    path: Path
    tables: Tables
    guesses: Sequence[ColumnGuess]

    @property
    def bag(self) -> bool:
        return is_bag(self.path)

    @staticmethod
    def of(path: Path, robot: Robot | None, joint: str = "", called: str = "") -> Recorded:
        """The recording; the joints of the robot and their limits help to guess.

        Columns without the name of a joint, and those of the joint `called` in the recording, belong to `joint`.
        """
        joints = [] if robot is None else [each.name for each in robot.joints]
        turning = [] if robot is None else [each for each in robot.joints if each.kind == "revolute"]
        limits = {each.name: (each.low, each.high) for each in turning}
        if joint in limits:
            limits |= {"": limits[joint], called: limits[joint]}
        tables = read_tables(path)
        require_names(path, tables)
        return Recorded(path, tables, guess_columns(tables, joints, limits, is_bag(path)))


def described(
    command: str,
    robot: Robot | None,
    joint: str,
    recorded: Recorded | None,
    at: Mapping[str, float],
    constants: Constants,
) -> Description:
    """The description of a joint of a robot, a recording, or both."""
    made = Description("joint", joint or "joint", command)
    if robot is not None:
        of_model(made, robot, robot.joint(joint), at)
        constants = replace(constants, drive=robot.joint(joint).drive, gear=robot.joint(joint).gear)
    if recorded is not None:
        entries = entries_of(recorded.tables, recorded.guesses, joint, constants, recorded.bag)
        if not joint:
            made.joint = (
                next((g.joint for g in recorded.guesses if g.column == entries.columns["q"][0]["column"]), "")
                or "joint"
            )
        made.columns = entries.columns
        made.remarks += entries.remarks
        made.sources.append(str(recorded.path))
        made.linear = made.linear or linear(entries)
    made.name = device_name(made.joint)
    if robot is not None and recorded is not None:
        _set_zero(made, robot.joint(joint), recorded)
    if recorded is not None:
        _choose_drive(made)
        _measure(made, recorded, robot is not None)
        if _by_names(made, recorded):
            made.columns = {}
    made.numbers.setdefault("rate", Number(RATE, "guessed", "no recording was given"))
    return made


def _others(robot: Robot, joint: str, recorded: Recorded) -> list[str]:
    """What to do about other joints of the recording: a diagnosis of all needs what drives each of them."""
    seen = {guess.joint for guess in recorded.guesses if guess.quantity == "position"}
    actuated = {each.name for each in robot.joints if each.kp is not None or each.drive == "torque"}
    driven = {
        guess.joint
        for guess in recorded.guesses
        if guess.quantity in DRIVEN or (guess.quantity == "position command" and guess.joint in actuated)
    }
    others = [each.name for each in robot.joints if each.name in seen and each.name != joint]
    if not others:
        return []
    names = ", ".join(others)
    if undriven := [name for name in others if name not in driven]:
        return [
            f"the recording also has {names}: where they move they act on {joint}, which a diagnosis of all joints "
            f"together includes; it needs torque or current of {', '.join(undriven)}, or goals and a model with gains"
        ]
    return [
        f"the recording also has {names}: where they move they act on {joint}, so diagnose all "
        f"joints together: via gap diagnose {recorded.path} --arm {robot.file}"
    ]


def _set_zero(made: Description, joint: RobotJoint, recorded: Recorded) -> None:
    """The zero of counts in the middle of a turn where the limits of the joint show it, else a remark."""
    entry = made.columns["q"][0]
    table = next(
        each.table
        for each in recorded.guesses
        if each.column == entry["column"] and each.table == entry.get("topic", each.table)
    )
    q = WireColumn(**entry).factor * numbers(recorded.tables[table], entry["column"])
    low, high = float(np.nanquantile(q, 0.01)), float(np.nanquantile(q, 0.99))
    spare = BEYOND * max(abs(joint.low), abs(joint.high))
    least, most = joint.low - spare, joint.high + spare
    if not joint.low < joint.high or (least <= low and high <= most):
        return
    if "counts_per_turn" in entry and least <= low - np.pi and high - np.pi <= most:
        for name in ("q", "equilibrium"):
            columns, reason = made.columns.get(name, ({}, ""))
            if "counts_per_turn" in columns:
                why = f"{reason}; by the limits of the joint, its zero is in the middle of a turn"
                made.columns[name] = {**columns, "offset": -float(np.pi)}, why
        return
    unit = "m" if made.linear else "rad"
    made.remarks.append(
        f"positions from {low:.3g} to {high:.3g} {unit} are beyond the limits of the joint, {joint.low:.3g} to "
        f"{joint.high:.3g} {unit}: unit, sign or zero of the recording differs from the model; state unit, scale or "
        f"offset [{unit}] of all angles under wire.columns"
    )


def _by_names(made: Description, recorded: Recorded) -> bool:
    """Whether the names of link and drive suffice to find everything in a bag."""
    entries = [entry for entry, _ in made.columns.values()]
    return recorded.bag and all(
        entry["topic"] == "/joint_states" and entry["column"].partition(".")[0] == made.joint for entry in entries
    )


def _choose_drive(made: Description) -> None:
    """A joint with goals and no torque has a position drive; one with torques a torque drive, unless its model says.

    A position drive makes its torque from the goals: the measured one beside them does not act once more.
    """
    columns = made.columns
    torque = {"tau_1", "external_torque"} & columns.keys()
    entry, why = columns.get("external_torque", ({}, ""))
    if made.drive == "position" and "equilibrium" in columns and entry.get("measured"):
        del columns["external_torque"]
        columns["tau_1"] = {key: value for key, value in entry.items() if key != "measured"}, why
    if torque and "equilibrium" not in columns and made.drive == "position":
        made.drive = "torque"
        made.remarks.append("the torques of the recording drive the joint: the position drive of the model is left out")
    if torque and made.drive == "torque":
        columns.pop("equilibrium", None)
    elif not torque and "equilibrium" in columns and made.drive == "torque":
        made.drive = "position"
        if "inertia" in made.numbers:
            guess_gains(made)
    elif not torque and "equilibrium" not in columns:
        made.remarks.append(
            "the recording has neither torques nor goals: a diagnosis needs one of them; enter the voltage of a motor "
            "under wire.columns as external_torque with scale kt / R, and add kt^2 / R to viscous_friction"
        )
    if made.drive == "torque":
        for name in ("kp", "kd", "torque_limit", "delay"):
            made.numbers.pop(name, None)


def _measure(made: Description, recorded: Recorded, modelled: bool) -> None:
    """Numbers that the recording shows. Without a model, the joint's own numbers are among them."""
    name, numbers = recorded.path.name, made.numbers
    if made.drive == "position" and "kp" not in numbers:
        raise SignalError(
            f"{recorded.path}: has goals and no torque, from which no inertia follows; add the URDF or MJCF file"
        )
    guesses = {
        each: Number(value, "guessed", "")
        for each, value in (("inertia", 1.0), ("viscous_friction", 0.0), ("rate", RATE))
    }
    provisional = replace(made, numbers={**guesses, **numbers})
    device = parse_device(provisional.text(), made.name)
    log = JointLog.of(name, device, joint_of(recorded.tables, device, str(recorded.path), recorded.bag))
    found = survey(log)
    if not modelled:
        made.confidence = "identified"
        for each, fitted in fit_joint(log).items():
            known = max(3.0 * fitted.sd / fitted.value, 0.05) if fitted.value else None
            note = f"least squares on {name}, standard deviation {fitted.sd:.2g}"
            numbers[each] = Number(fitted.value, "measured", note, None if known is None else min(known, GUESS))
        made.remarks.append(
            "inertia, friction and gravity come from this recording: a diagnosis of it can only find what they leave"
        )
    elif made.drive == "position" and numbers["kp"].origin == "guessed":
        _measure_gains(made, log)
    numbers["rate"] = Number(found.rate, "measured", f"median of the stamps of {name}")
    if found.link_quantum is not None:
        numbers["link_quantum"] = Number(found.link_quantum, "measured", f"grid of the positions in {name}")
    largest = float(np.nanmax(np.abs(log.measured["tau"]))) if "tau" in log.measured else 0.0
    if found.torque_noise is not None and found.torque_noise > EXACT * largest:
        numbers["torque_noise"] = Number(found.torque_noise, "measured", f"upper bound from {name}")


def _measure_gains(made: Description, log: JointLog) -> None:
    """Gains that the model does not state, relative to its gravity torque, or a remark that they are guesses."""
    numbers = made.numbers
    gravity = [numbers[name].value if name in numbers else 0.0 for name in ("gravity_torque", "gravity_angle")]
    found = fit_gains(log, *gravity)
    if not made.linear and "kp" in found:
        for name, fitted in found.items():
            note = f"least squares on {log.name} with the model's gravity, standard deviation {fitted.sd:.2g}"
            # In 16 logs of an XL330, kp is 0.4 to 1.2 times that of its manual: lowest where the drive saturates.
            numbers[name] = Number(fitted.value, "measured", note, GUESS)
        made.remarks.append(
            "the model has no gains of the drive: kp and kd are fitted to the recording, relative to the gravity "
            "torque of the model; write the gains if you know them"
        )
        return
    made.remarks.append(
        "the model has no gains of the drive, and the recording no torque: kp and kd are guesses. Torques and inertias "
        "are known relative to kp only; write the gains"
    )
