"""Continuous angles from encoders that start again after each turn, and goals beside them.

Such an encoder measures angles within one turn P, and at its end jumps by P less the motion of one sample. A jump
counts as this end when the remaining motion, jump - P, is at most 1.5 times the largest step without a jump (the motion
can be fastest at the end of the turn). Other jumps, as zeros of a lost encoder, stay for the checks that report them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import tau
from typing import NamedTuple

import numpy as np

from via_core.signals import Array, Signals

ROUNDED = 1e-3  # [-] share of a turn by which rounded angles may exceed it
FASTER = 1.5  # [-] largest step over the end of a turn, in largest other steps
GOALS = {"q": "equilibrium", "theta": "motor"}  # angle -> its goal


class Continuous(NamedTuple):
    """Signals without ends of turns, and how often each channel passed one, e.g. {'theta_2': 3}."""

    measured: Signals
    commands: Signals | None
    passed: Mapping[str, int]


def continuous(
    measured: Signals, commands: Signals | None, turns: Mapping[tuple[str, int], float] | None = None
) -> Continuous:
    """The signals of a joint with continuous `q` and `theta`, and goals moved to the turn of their angle.

    turns  (channel, number of the motor or 0) -> turn [rad] of an encoder that is not on the joint; others: 2 pi
    """
    angles: dict[str, Array] = {}
    goals: dict[str, Array] = {}
    passed: dict[str, int] = {}
    for name, goal in GOALS.items():
        if name not in measured:
            continue
        columns = measured[name].reshape(len(measured), -1).copy()
        for k in range(columns.shape[1]):
            number = k + 1 if measured[name].ndim == 2 else 0
            turn = (turns or {}).get((name, number), tau)
            column, ends = unrolled(measured.time, columns[:, k], turn)
            if not ends:
                continue
            columns[:, k] = column
            passed[f"{name}_{number}" if number else name] = ends
            if commands is not None and goal in commands and commands.units[goal] == "rad":
                wanted = goals.setdefault(goal, commands[goal].copy()).reshape(len(commands), -1)  # a view
                beside = Signals(measured.time, {"angle": column}, {"angle": "rad"}).resample(commands.time)["angle"]
                wanted[:, k] += turn * np.nan_to_num(np.rint((beside - wanted[:, k]) / turn))
        angles[name] = columns.reshape(measured[name].shape)
    if not passed:
        return Continuous(measured, commands, {})
    measured = replace(measured, channels={**measured.channels, **angles})
    if commands is not None:
        commands = replace(commands, channels={**commands.channels, **goals})
    return Continuous(measured, commands, passed)


def unrolled(time: Array, angle: Array, turn: float) -> tuple[Array, int]:
    """Angle (N,) [rad] without ends of turns, and their number. NaN stay."""
    known = np.flatnonzero(np.isfinite(angle))
    step, dt = np.diff(angle[known]), np.diff(time[known])
    jumps = np.abs(step) > 0.5 * turn
    if not jumps.any() or jumps.all() or np.ptp(angle[known]) > (1.0 + ROUNDED) * turn:
        return angle, 0
    fastest = float(np.max(np.abs(step[~jumps]) / dt[~jumps]))
    ends = jumps & (np.abs(np.abs(step) - turn) <= FASTER * fastest * dt)
    turns = np.concatenate([[0.0], np.cumsum(-np.sign(step) * ends)])
    moved = angle.copy()
    moved[known] += turn * turns
    return moved, int(np.count_nonzero(ends))
