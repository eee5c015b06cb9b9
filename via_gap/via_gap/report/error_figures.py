"""Figures of held-out intervals: errors by region, and traces of the intervals with the largest errors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

from via_gap.report.binning import bins_of, quantities, rms, six
from via_gap.report.figures import ErrorBin, ErrorFigure, TraceFigure
from via_gap.report.simulated_intervals import SimulatedInterval

POINTS = 240  # of a trace
INTERVALS: tuple[Literal["after", "before"], ...] = ("after", "before", "after")  # each the worst one left


def error_figures(intervals: Sequence[SimulatedInterval], n_transmissions: int) -> tuple[ErrorFigure, ...]:
    """Error of every signal before and after the repair, against speed, deflection, angle and time."""
    if not intervals:
        return ()
    states = np.concatenate([each.states for each in intervals])
    time = np.concatenate([each.time for each in intervals])
    found = []
    for column, axis in enumerate(intervals[0].axes):
        before = np.concatenate([each.before[:, column] - each.measured[:, column] for each in intervals])
        after = np.concatenate([each.after[:, column] - each.measured[:, column] for each in intervals])
        floor = np.concatenate([np.full(len(each.time), each.floor[column]) for each in intervals])
        for by, (unit, values) in quantities(states, time, axis, n_transmissions).items():
            bins = tuple(
                ErrorBin(low=six(low), high=six(high), centre=six(np.median(values[inside])),
                         before=rms(before[inside]), after=rms(after[inside]), floor=rms(floor[inside]))
                for low, high, inside in bins_of(by, values)
            )  # fmt: skip
            found.append(ErrorFigure(signal=intervals[0].signal(axis), by=by, unit=unit, bins=bins))
    return tuple(found)


def trace_figures(intervals: Sequence[SimulatedInterval], longest: float) -> tuple[TraceFigure, ...]:
    """Every signal of the intervals [at most `longest` s] that are worst after and before the repair."""
    pieces = [piece for each in intervals for piece in _pieces(each, longest)]
    found = []
    for by in INTERVALS[: len(pieces)]:
        worst = max(range(len(pieces)), key=lambda i: _size(pieces[i], by))
        found.extend(_traces(pieces.pop(worst), by))
    return tuple(found)


def _pieces(interval: SimulatedInterval, longest: float) -> list[SimulatedInterval]:
    """The interval in pieces of at most `longest` [s], cut where the simulation restarts if it ever does."""
    cuts = np.flatnonzero(interval.restarts)
    cuts = cuts if len(cuts) else np.arange(len(interval.time))
    begins = [int(cuts[0])]
    for this, following in pairwise([*cuts, len(interval.time)]):
        if interval.time[following - 1] - interval.time[begins[-1]] > longest and this > begins[-1]:
            begins.append(int(this))
    return [interval.part(a, b) for a, b in pairwise([*begins, len(interval.time)])]


def _size(piece: SimulatedInterval, by: Literal["after", "before"]) -> float:
    """Squared error in units of the floor, summed over samples so that short pieces do not win."""
    error = (getattr(piece, by) - piece.measured) / np.maximum(piece.floor, 1e-9)
    return float(np.sum(error**2))


def _traces(piece: SimulatedInterval, by: Literal["after", "before"]) -> list[TraceFigure]:
    every = max(1, -(-len(piece.time) // POINTS))
    begins = np.flatnonzero(piece.restarts)
    kept = np.arange(0, len(piece.time), every)
    restarts = tuple(int(np.searchsorted(kept, b)) for b in begins[1:] if b <= kept[-1])
    columns = {"measured": piece.measured, "before": piece.before, "after": piece.after}
    return [
        TraceFigure(
            log=piece.log, signal=piece.signal(axis), worst=by, time=tuple(map(six, piece.time[kept])),
            restarts=restarts,
            **{name: tuple(map(six, values[kept, column])) for name, values in columns.items()},
        )
        for column, axis in enumerate(piece.axes)
    ]  # fmt: skip
