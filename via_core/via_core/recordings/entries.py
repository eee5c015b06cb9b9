"""Columns of a recording as entries of a device file: `wire.columns` of one rigid joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from via_core.errors import SignalError
from via_core.recordings.drive_law import with_whole_torque, without_partial_goals
from via_core.recordings.guess import ColumnGuess, Quantity, guess_time, of_joint
from via_core.recordings.tables import Tables, numbers
from via_core.recordings.units import COUNTS, factor, is_linear
from via_core.signals import Array

CHANNELS: dict[Quantity, str] = {
    "position": "q", "velocity": "q_velocity", "torque": "tau_1", "current": "tau_1", "position command": "equilibrium",
    "torque command": "external_torque",
}  # fmt: skip
# Of a position on the goals that it follows: slope of the regression and correlation. Lag and a load lower both,
# resonance raises the slope.
SLOPES, CORRELATION = (0.4, 2.0), 0.6
ENDS = 0.1  # distance of the last positions from a constant goal, relative to the range of the positions


@dataclass(frozen=True)
class Constants:
    """What no recording states."""

    counts_per_turn: float | None = None
    torque_constant: float | None = None  # [N m/A] at the joint
    joint: str = ""  # name or number of the joint in the recording, where the model has another
    drive: Literal["", "torque", "position"] = ""  # what commands of the model's actuator are; '': not known
    gear: float = 1.0  # [N m] per command of a torque actuator


@dataclass(frozen=True)
class Entries:
    """Entries by channel with their reasons, and remarks on what is not used."""

    columns: dict[str, tuple[dict[str, Any], str]]
    remarks: tuple[str, ...]


def entries_of(
    tables: Tables, guesses: Sequence[ColumnGuess], joint: str, constants: Constants = Constants(), bag: bool = False
) -> Entries:
    """Entries for one joint. Raises SignalError with the remedy where there is no position of it."""
    own = ("", constants.joint or joint)  # names of columns of this joint
    chosen = of_joint(guesses, own[1])
    if "position" not in chosen:
        there = ", ".join(f"'{each.column}'" for each in guesses) or "none"
        raise SignalError(f"no column looks like a position; there are: {there}; name it under wire.columns as q")
    measured = "torque" in chosen or ("current" in chosen and constants.torque_constant is not None)
    driven, remarks = (without_partial_goals if measured else with_whole_torque)(tables, chosen)
    found = _by_values(tables, driven, constants.drive)
    columns, explained = {}, set()
    time = guess_time(tables[chosen["position"].table], bag)
    if time is None:
        raise SignalError("no column of the recording increases like a time; add one, or name it under wire.columns")
    if not bag and (time.column, time.unit) != ("time", "s"):
        columns["time"] = {"column": time.column, "unit": time.unit}, time.reason
    for quantity, channel in CHANNELS.items():
        guess = found.get(quantity)
        if channel == "tau_1" and not bag:
            channel = "external_torque"  # a logger's row holds what acts from then on; messages, what acted before
        if guess is None or channel in columns or (channel == "external_torque" and "tau_1" in columns):
            continue
        if quantity == "velocity" and not guess.sure and COUNTS.fullmatch(chosen["position"].unit):
            continue  # drives that report counts have units of speed of their own
        entry: dict[str, Any] = {"column": guess.column}
        if channel == "external_torque" and quantity != "torque command":
            entry["measured"] = True
        if bag:
            entry["topic"] = guess.table
        if quantity == "torque command" and quantity not in chosen and constants.gear not in (0.0, 1.0):
            entry["scale"] = constants.gear
        if guess.unit not in ("rad", "rad/s", "N m"):
            entry["unit"] = guess.unit
        if COUNTS.fullmatch(guess.unit):
            if constants.counts_per_turn is None:
                if quantity in ("position", "position command"):
                    raise SignalError(
                        f"column '{guess.column}' looks like counts: add --counts-per-turn, e.g. --counts-per-turn 4096"
                    )
                continue
            entry["counts_per_turn"] = constants.counts_per_turn
        if quantity == "current":
            if constants.torque_constant is None:
                explained.add(guess.column)
                remarks.append(
                    f"column '{guess.column}' looks like a current and is not used; --torque-constant makes it a "
                    "torque: write N m/A at the joint, which is the constant of the motor times the gear ratio"
                )
                continue
            entry |= {"unit": guess.unit, "torque_constant": constants.torque_constant}
        if guess.instead and quantity in ("position", "current"):
            remarks.append(
                f"column '{guess.column}' states no unit: {guess.reason.removesuffix('; check')}; if it is in "
                f"{guess.instead}, call it '{guess.column} [{guess.instead}]' and repeat this command"
            )
        columns[channel] = (
            entry,
            f"{guess.reason}{'' if guess.sure or 'check' in guess.reason else f'; taken as {guess.unit}'}",
        )
    for quantity in ("position", "torque"):
        alike = [each.column for each in guesses if each.quantity == quantity and each.joint in own]
        if len(alike) > 1 and not bag:
            remarks.append(
                f"several columns look like the {quantity}: {', '.join(alike)}; '{chosen[quantity].column}' is used; "
                "check its name under wire.columns"
            )
    used = {each[0]["column"] for each in columns.values()} | {time.column} | explained
    left = [each.column for each in guesses if each.column not in used and each.joint in own and not bag]
    if left:
        remarks.append(f"columns not used: {', '.join(left[:12])}{' ...' if len(left) > 12 else ''}")
    return Entries(columns, tuple(remarks))


def linear(entries: Entries) -> bool:
    """Whether the position is a length."""
    return is_linear(str(entries.columns["q"][0].get("unit", "rad")))


def _by_values(
    tables: Tables, chosen: Mapping[Quantity, ColumnGuess], drive: Literal["", "torque", "position"]
) -> Mapping[Quantity, ColumnGuess]:
    """The columns, with a command whose name shows no quantity as what the model's actuator takes.

    Without such a model it is a goal if the position follows it, else a torque.
    """
    command, position = chosen.get("position command"), chosen["position"]
    if command is None or command.sure or command.table != position.table or "torque command" in chosen:
        return chosen
    if {"pos", "position", "angle", "q", "theta"} & set(command.column.lower().replace("_", " ").split()):
        return chosen
    reason = "command of the model's torque actuator"
    if not drive:
        q, u = (numbers(tables[each.table], each.column) for each in (position, command))
        counts = COUNTS.fullmatch(command.unit) or COUNTS.fullmatch(position.unit)
        there = np.isfinite(q) & np.isfinite(u)
        if _follows(q[there], u[there] * (1.0 if counts else factor(command.unit) / factor(position.unit))):
            return chosen
        reason = "a command that the position does not follow, taken as torque; check"
    elif drive == "position":
        return chosen
    changed: dict[Quantity, ColumnGuess] = {
        **chosen,
        "torque command": replace(command, quantity="torque command", unit="N m", reason=reason),
    }
    del changed["position command"]
    return changed


def _follows(q: Array, u: Array) -> bool:
    """Whether positions (N,) follow goals (N,): they are near, and change with them by about as much.

    A small torque is near a small position as well, but the position changes much more than it.
    """
    if len(q) < 2:
        return False
    if np.ptp(u) == 0.0:  # one goal: the position ends at it
        return bool(u[0] != 0.0 and abs(np.mean(q[-max(len(q) // 10, 1) :]) - u[0]) <= ENDS * np.ptp(q))
    if np.sqrt(np.mean((u - q) ** 2)) > np.std(q):
        return False
    covariance = np.cov(q, u)
    slope = covariance[0, 1] / covariance[1, 1]
    return bool(SLOPES[0] <= slope <= SLOPES[1] and np.corrcoef(q, u)[0, 1] >= CORRELATION)
