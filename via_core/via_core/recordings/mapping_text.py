"""The commented mapping file for `via bag import`, from guesses of the columns of a recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from via_core.devices import load_device
from via_core.errors import SignalError
from via_core.recordings.entries import Constants
from via_core.recordings.guess import ColumnGuess, TimeGuess
from via_core.recordings.tables import TEXTS
from via_core.recordings.texts import delimiter_of
from via_core.recordings.units import COUNTS

QUANTITIES = {"position": "position", "velocity": "velocity", "torque": "effort", "current": "effort"}
_OWN_TORQUE = re.compile(r"tau_(link|\d)")  # columns of VIA's own tables: until the stamp, as in messages
COMMANDS = {"position command": "equilibrium", "torque command": "torque"}


def mapping_text(
    path: Path, time: TimeGuess, guesses: Sequence[ColumnGuess], constants: Constants, device: str = "", joint: str = ""
) -> str:
    """A mapping of one file, and of files whose names differ in digits only. Raises SignalError without a position.

    device  file or name of the device of the only joint; without it, joints keep their names and commands are ignored.
            Numbers in the names of columns are those of its motors, as in theta_1 and tau_2
    joint   name for columns that name none
    """
    joints: list[tuple[dict[str, Any], str]] = []
    commands: list[tuple[dict[str, Any], str]] = []
    ignored: list[tuple[str, str]] = []
    taken = set()
    motors = load_device(device).n_motors if device else 0
    for guess in guesses:
        entry: dict[str, Any] = {"column": guess.column}
        quantity = QUANTITIES.get(guess.quantity, "")
        name = guess.joint or joint or "joint"
        if device:
            number = int(guess.joint) if guess.joint.isdigit() else 0
            name = f"motor_{number}" if 1 <= number <= motors else "motor_1" if quantity == "effort" else "link"
        goal: Any = (name, quantity) if quantity else COMMANDS.get(guess.quantity, "")
        reason = _why_not(guess, constants, device)
        if reason or goal in taken:
            ignored.append((guess.column, reason or f"another column is already the {guess.quantity}"))
            continue
        taken.add(goal)
        why = guess.reason
        if quantity:
            entry |= {"joint": name, "quantity": quantity, "unit": guess.unit}
            if quantity == "effort" and not _OWN_TORQUE.fullmatch(guess.column):
                entry["interval"] = "begins"
                why += "; taken as what acts from the stamp on, `ends`: until the stamp"
        else:
            entry |= {"quantity": COMMANDS[guess.quantity], "unit": guess.unit}
        if COUNTS.fullmatch(guess.unit):
            entry["counts_per_turn"] = constants.counts_per_turn
        if guess.quantity == "current":
            entry["torque_constant"] = constants.torque_constant
        (joints if quantity else commands).append((entry, why))
    if not any(entry["quantity"] == "position" for entry, _ in joints):
        raise SignalError(f"{path}: no column looks like a position; there are: {', '.join(g.column for g in guesses)}")
    pattern = "(?P<run>" + re.sub(r"\d+", r"\\d+", re.escape(path.stem)) + ")" + re.escape(path.suffix)
    out = [
        "# Guessed from the names and values of the columns. Check units and signs before you trust any result.",
        f"title: {_flow(f'Recordings like {path.name}')}",
        f"source: [{_flow(str(path))}]",
        *([f"device: {_flow(device)}"] if device else []),
        "recordings:",
        f"  pattern: {_flow(pattern)}  # regular expression for the names of the files",
        "  bag: '{run}'",
        *([f"  delimiter: {_flow(delimiter_of(path))}"] if path.suffix.lower() in TEXTS else []),
        f"  time: {_flow({'column': time.column, 'unit': time.unit})}  # {time.reason}",
        "  joints:",
        *(f"    - {_flow(entry)}  # {why}" for entry, why in joints),
        *(["  commands:"] if commands else []),
        *(f"    - {_flow(entry)}  # {why}" for entry, why in commands),
        *(["  ignore:"] if ignored else []),
        *(f"    {_flow(column)}: {_flow(why)}" for column, why in ignored),
    ]
    return "\n".join(out) + "\n"


def _why_not(guess: ColumnGuess, constants: Constants, device: str) -> str:
    """Why a column cannot be mapped; '' if it can."""
    if not guess.quantity:
        return "not recognised"
    if guess.quantity not in {*QUANTITIES, *COMMANDS}:
        return f"a {guess.quantity}, which no message holds"
    if guess.quantity in COMMANDS and not device:
        return "a command; add --device to map it"
    if COUNTS.fullmatch(guess.unit) and constants.counts_per_turn is None:
        return "looks like counts; add --counts-per-turn to map it"
    if guess.quantity == "current" and constants.torque_constant is None:
        return "looks like a current; add --torque-constant to map it"
    return ""


def _flow(value: Any) -> str:
    """A value as YAML on one line."""
    return (
        yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
        .strip()
        .removesuffix("...")
        .strip()
    )
