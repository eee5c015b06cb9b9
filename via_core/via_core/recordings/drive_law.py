"""Drives that make their torque from goals, gains and a feed-forward, all of which a command contains:

    torque = kp (q_des - q) + kd (qd_des - qd) + tau_ff

The feed-forward is the torque only where both gains are 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from via_core.errors import SignalError
from via_core.recordings.guess import ColumnGuess, Quantity
from via_core.recordings.tables import Tables, numbers

Chosen = dict[Quantity, ColumnGuess]
GAINS: tuple[Quantity, ...] = ("kp", "kd")


def with_whole_torque(tables: Tables, chosen: Chosen) -> tuple[Chosen, list[str]]:
    """The columns of a joint without a measured torque, its torque command only if it is the whole torque; remarks.

    Beside gains, a torque command is the feed-forward, unless another column is.
    Raises SignalError with the formula where the torque consists of more columns than one.
    """
    gains = [chosen[each] for each in GAINS if each in chosen]
    part = chosen.get("feed-forward") or (chosen.get("torque command") if gains else None)
    others: Chosen = {each: guess for each, guess in chosen.items() if guess is not part}
    if part is not None and len(gains) == len(GAINS) and not any(_acts(tables, each) for each in gains):
        whole = replace(part, quantity="torque command", reason=f"{part.reason}, and the gains beside it are 0")
        return {**others, "torque command": whole}, []
    beyond = [each for each in (part, chosen.get("velocity command")) if each is not None and _acts(tables, each)]
    if beyond and gains and "torque command" not in others:
        raise SignalError(
            f"no column holds the torque of the drive, which is {_formula(chosen, part)}; add a column with it, "
            f"'{_name(chosen)}', in N m and rad"
        )
    if part is None:
        return chosen, []
    what = f"column '{part.column}' is a feed-forward, a part of the torque of the drive"
    if not {"torque command", "position command"} & others.keys():
        raise SignalError(
            f"{what}, and there is no torque and no goal; add a column with the whole torque, '{_name(chosen)}', e.g. "
            f"kp * (q_des - q) + kd * (qd_des - qd) + {part.column}, or rename this one if the drive has no gains"
        )
    return others, [f"{what}: not used"]


def without_partial_goals(tables: Tables, chosen: Chosen) -> tuple[Chosen, list[str]]:
    """The columns of a joint with a measured torque, without goals that are only a part of what its drive follows.

    A position drive of a model would follow them alone.
    """
    beside = [chosen[each] for each in ("velocity command", "feed-forward", "torque command") if each in chosen]
    goal = chosen.get("position command")
    if goal is None or not any(each in chosen for each in GAINS) or not any(_acts(tables, each) for each in beside):
        return chosen, []
    others: Chosen = {each: guess for each, guess in chosen.items() if guess is not goal}
    parts = ", ".join(f"'{each.column}'" for each in beside)
    return others, [
        f"the goals '{goal.column}' are not all that the drive follows, beside {parts}: the measured torque is used"
    ]


def _acts(tables: Tables, guess: ColumnGuess) -> bool:
    values = numbers(tables[guess.table], guess.column)
    return bool(np.any(values[np.isfinite(values)] != 0.0))


def _formula(chosen: Mapping[Quantity, ColumnGuess], part: ColumnGuess | None) -> str:
    """The torque by the names of the columns."""
    name: dict[str, str] = {each: guess.column for each, guess in chosen.items()}
    terms = [
        f"{name[gain]} * ({name.get(f'{what} command', 0)} - {name.get(what, f'the {what}')})"
        for gain, what in zip(GAINS, ("position", "velocity"), strict=True)
        if gain in name
    ]
    return " + ".join([*terms, *([part.column] if part is not None else [])])


def _name(chosen: Mapping[Quantity, ColumnGuess]) -> str:
    """A name for the column of the torque, of the same joint as the position."""
    joint = chosen["position"].joint
    return f"{joint}_tau" if joint else "tau"
