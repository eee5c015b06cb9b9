"""Runs of several logs, simulated in the same blocks of lanes.

A block costs as much with one run as with LANES runs (`via_sim.lockstep`), so a few runs of each of many short logs
would leave most lanes idle. A log describes its runs as an iterator of *legs*: parts of equal length, between which it
resets states. One call computes the legs of several logs. A log with enough runs to fill its blocks is not mixed with
others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from via_core.signals import Array, Indices, Mask
from via_sim.lockstep.pack import LANES
from via_sim.lockstep.run import run_many

from via_gap.residual.threads import THREADS, per_call, together


@dataclass(frozen=True, eq=False)
class Leg:
    """Runs over the same number of ticks, n. Before the next leg is asked for, `states` and `moved` are computed.

    rows      (K, N_PARAMETERS)
    states    (K, S) at the beginning, then at the end
    commands  (T, N_COMMANDS)
    begins    (K,) index of the first command of each run
    ticks     n
    moved     (K, n + 1, 6) angles and velocities
    last      whether the states at the end are not needed: longer legs may be computed with it
    """

    rows: Array
    states: Array
    commands: Array
    begins: Indices
    ticks: int
    last: bool = False
    moved: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "moved", np.empty((len(self.rows), self.ticks + 1, 6)))


@dataclass(frozen=True, eq=False)
class Runs:
    """The legs of `count` runs; runs of equal `kind` (period, substeps) can share a block."""

    legs: Iterator[Leg]
    count: int
    kind: tuple[float, ...]


def runs_of(begins: Indices, ticks: int, lasting: Mask) -> tuple[Indices, Indices]:
    """Chains (n, 2) of segments of `ticks`, and runs (m, 2), each a row and a chain, longest chains first.

    begins   (C,) ascending first ticks of the segments
    chains   index of the first segment, and their number: those that follow on one another, then each segment alone
    lasting  (K,) whether a row's state continues from segment to segment; the runs of other rows are single segments
    """
    every = np.arange(len(begins))
    first = np.flatnonzero(np.diff(begins, prepend=-2 * ticks) != ticks)
    neighbours = np.stack([first, np.diff(np.append(first, len(begins)))], axis=1)
    chains = np.concatenate([neighbours, np.stack([every, np.ones_like(every)], axis=1)])
    of = (np.arange(len(first)) if each else len(first) + every for each in lasting)
    runs = np.concatenate([np.stack([np.full(len(own), row), own], axis=1) for row, own in enumerate(of)])
    return chains, runs[np.argsort(-chains[runs[:, 1], 1], kind="stable")]  # by length; then rows alike, terms alike


def divided(runs: Indices) -> list[Indices]:
    """Runs (n, ...) of one log in pieces that fill blocks, alike on every thread."""
    size = per_call(len(runs), LANES)
    return [runs[first : first + size] for first in range(0, len(runs), size)]


def simulate(runs: Sequence[Runs]) -> None:
    """Compute every leg, on all threads."""
    full = [[each] for each in runs if each.count >= LANES]
    together(partial(_advance, group) for group in full + _mixed([each for each in runs if each.count < LANES]))


def _mixed(runs: Sequence[Runs]) -> list[list[Runs]]:
    """Groups of runs of one kind, which fill their blocks, alike on every thread."""
    groups: list[list[Runs]] = []
    for kind in dict.fromkeys(each.kind for each in runs):
        alike = [each for each in runs if each.kind == kind]
        most = LANES * -(-sum(each.count for each in alike) // (LANES * THREADS))
        group: list[Runs] = []
        for each in alike:
            if group and sum(other.count for other in group) + each.count > most:
                groups.append(group)
                group = []
            group = [*group, each]
        groups.append(group)
    return groups


def _advance(group: Sequence[Runs]) -> None:
    """All legs of a group, those of different logs side by side."""
    waiting = [each.legs for each in group]
    while waiting:
        there = [(legs, leg) for legs in waiting if (leg := next(legs, None)) is not None]
        waiting = [legs for legs, _ in there]
        lengths = {leg.ticks for _, leg in there if not leg.last}
        for ticks in lengths:
            _compute([leg for _, leg in there if not leg.last and leg.ticks == ticks])
        _compute(sorted((leg for _, leg in there if leg.last), key=lambda leg: -leg.ticks))


def _compute(legs: Sequence[Leg]) -> None:
    """Legs of the same length, or last ones, longest first."""
    if len(legs) == 1:
        (leg,) = legs
        run_many(leg.rows, leg.states, leg.commands, leg.begins, leg.moved)
    elif legs:
        rows, states = (np.concatenate([getattr(leg, name) for leg in legs]) for name in ("rows", "states"))
        after = np.zeros((legs[0].ticks, legs[0].commands.shape[1]))  # a shorter leg goes on: nobody looks at it
        first = np.cumsum([0, *(len(leg.commands) for leg in legs[:-1])])
        commands = np.concatenate([*(leg.commands for leg in legs), after])
        begins = np.concatenate([start + leg.begins for start, leg in zip(first, legs, strict=True)])
        owner = np.repeat(np.arange(len(legs)), [len(leg.rows) for leg in legs])
        for block in (slice(k, k + LANES) for k in range(0, len(rows), LANES)):
            moved = np.empty((len(rows[block]), legs[owner[block][0]].ticks + 1, 6))
            run_many(rows[block], states[block], commands, begins[block], moved)
            for number in dict.fromkeys(owner[block]):
                leg, own = legs[number], np.flatnonzero(owner == number)
                here = (own >= block.start) & (own < block.stop)
                leg.states[here] = states[own[here]]
                leg.moved[here] = moved[own[here] - block.start, : leg.ticks + 1]
