"""The numbers behind a report's charts, computed from the experiment.

Short segments are compared as in the gap: the part of an error that the noise of the segment's start explains is not
counted, so 'simulated' is the measured angle minus the remaining error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from via_core.devices import Device
from via_core.signals import Array
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.location import MEASUREMENT_ONLY, Location
from via_gap.logs.log import JointLog
from via_gap.logs.replay import simulated_log
from via_gap.report.binning import bins_of, quantities, rms, six
from via_gap.report.figures import (
    ErrorBin,
    ErrorFigure,
    Figures,
    JointSketch,
    Member,
    TraceFigure,
    Trial,
)
from via_gap.report.torque_figures import missing_torques, order_spectra, periodic, residual_figures
from via_gap.residual.errors import NAMES
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.repaired_device import repaired_device
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Indices, Segments
from via_gap.selection.evidence import Evaluation, difference
from via_gap.selection.experiment import Experiment
from via_gap.selection.verdict import Decision

STRETCH = 2.0  # [s] of segments that are drawn, and
FREE_STRETCH = 5.0  # [s] of a free run
POINTS = 240  # of a trace
STRETCHES: tuple[Literal["after", "before"], ...] = ("after", "before", "after")  # each the worst that is left
TRIALS = 16  # that are listed


@dataclass(frozen=True, eq=False)
class Stretch:
    """Held-out samples in a row.

    time      (N,) [s] since the log began
    states    (N, 6) [rad, rad/s] smoothed; NaN: not measured
    measured, before, after  (N, a) [rad] of `axes`; of equations the drive's torque [N m]
    restarts  (N,) whether the simulation restarts at a sample
    floor     (a,) rms that sensor noise explains, in the same unit
    torque    whether it is of an equation
    """

    log: str
    axes: tuple[int, ...]
    time: Array
    states: Array
    measured: Array
    before: Array
    after: Array
    restarts: NDArray[np.bool_]
    floor: Array
    torque: bool = False


def evidence_figures(
    experiment: Experiment, candidates: CandidateSet, decision: Decision, models: Sequence[Evaluation],
    by: Literal["segments", "free run", "inverse dynamics"],
) -> Figures:  # fmt: skip
    """All pictures of one diagnosis; `by` is how the gap was measured."""
    judged, segments, chosen = experiment.judged, experiment.segments, decision.chosen
    device = judged.device
    if by == "free run":
        moved = repaired_device(device, judged.nuisances, chosen.fit.deviations)
        longest, stretches = FREE_STRETCH, free_stretches(device, moved, chosen.fit.effects, segments, experiment.held)
    else:
        two = judged.residual([judged.row(e.fit.effects, e.fit.deviations) for e in (experiment.nominal, chosen)])
        cut, longest = (segment_stretches, STRETCH) if by == "segments" else (torque_stretches, FREE_STRETCH)
        stretches = cut(judged, *two)
    missing = missing_torques(segments, experiment.nominal.fit, chosen.fit)
    compared = [location for location, _ in decision.shares]
    return Figures(
        joint=joint_sketch(segments[0].log),
        residuals=residual_figures(missing, device.n_transmissions),
        spectra=order_spectra(missing) if periodic([*decision.named, *compared]) else (),
        errors=error_figures(stretches, device.n_transmissions),
        traces=trace_figures(stretches, longest),
        trials=trial_figures(models, experiment.tuned),
        screened=screened_members(candidates.locations, models) if models else (),
        untried=untried_effects(candidates.locations),
    )


def joint_sketch(log: JointLog) -> JointSketch:
    """What a picture of the log's joint needs."""
    return JointSketch(
        arrangement=log.device.arrangement,
        drive="servo" if log.device.drive == "servo" else "torque",
        motors_seen=log.motors_seen,
        torque_seen=log.torque_seen,
    )


def segment_stretches(problem: ResidualModel, before: Array, after: Array) -> list[Stretch]:
    """Neighbouring segments of a problem, with whitened residuals (R,) of two simulations."""
    found, begin = [], 0
    for view in problem.views:
        segments, size = view.segments, len(view.chosen) * view.size
        shape = (len(view.chosen), -1, len(segments.axes))
        errors = [each[begin : begin + size].reshape(shape) * segments.noise for each in (before, after)]
        begin += size
        for run in np.split(np.arange(len(view.chosen)), np.flatnonzero(np.diff(view.chosen) > 1) + 1):
            measured = segments.measured[view.chosen[run]]
            bins = measured.shape[1]
            ticks = (segments.begin[view.chosen[run]][:, None] + segments.every * np.arange(1, bins + 1)).ravel()
            flat = measured.reshape(-1, len(segments.axes))
            first, second = (flat - each[run].reshape(flat.shape) for each in errors)
            restarts = np.arange(len(ticks)) % bins == 0
            found.append(
                Stretch(segments.log.name, segments.axes, ticks / segments.rate, segments.start[ticks], flat, first,
                        second, restarts, segments.noise)
            )  # fmt: skip
    return found


def torque_stretches(problem: ResidualModel, before: Array, after: Array) -> list[Stretch]:
    """Neighbouring segments judged by inverse dynamics, with the missing torque (R,) of two models."""
    found, begin = [], 0
    for view in problem.views:
        assert isinstance(view, InverseDynamics)
        segments, windows, size = view.segments, view.windows, len(view.chosen) * view.size
        shape = (len(view.chosen), len(windows.axes), -1)
        missing = [each[begin : begin + size].reshape(shape) * windows.floor[:, None] for each in (before, after)]
        begin += size
        sent = np.stack([view.over(windows.drive[view.inside, i], 0) for i in range(len(windows.axes))], axis=1)
        for run in np.split(np.arange(len(view.chosen)), np.flatnonzero(np.diff(view.chosen) > 1) + 1):
            ticks = (view.first[run] + windows.weights.shape[1] // 2).ravel()
            flat, first, second = (
                each[run].transpose(0, 2, 1).reshape(len(ticks), -1)
                for each in (sent, sent + missing[0], sent + missing[1])
            )
            found.append(
                Stretch(segments.log.name, windows.axes, ticks / segments.rate, segments.start[ticks], flat, first,
                        second, np.zeros(len(ticks), dtype=bool), windows.floor, True)
            )  # fmt: skip
    return found


def free_stretches(
    nominal: Device,
    repaired: Device,
    effects: Sequence[Effect],
    segments: Sequence[Segments],
    chosen: Sequence[Indices],
) -> list[Stretch]:
    """Held-out stretches of logs that are simulated from beginning to end; the link angle only."""
    found = []
    for each, which in zip(segments, chosen, strict=True):
        log = each.log
        if not len(which) or log.commands is None:
            continue
        seen = np.isfinite(log.measured["q"])
        time, q = log.measured.time[seen], log.measured["q"][seen]
        runs = [
            simulated_log(device, log.measured, log.commands, added)
            for device, added in ((nominal, ()), (repaired, effects))
        ]
        before, after = (np.interp(time, run.time, run["q"])[:, None] for run in runs)
        segment = np.clip(np.searchsorted(each.time, time, side="right") - 1, 0, len(each) - 1)
        inside = np.flatnonzero(np.isin(segment, which))
        ticks = np.clip(np.rint((time - each.origin) * each.rate).astype(int), 0, len(each.start) - 1)
        quantum = nominal.sensors.link_quantum or 0.0
        for run_ in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
            if len(run_):
                found.append(
                    Stretch(log.name, (0,), time[run_] - time[0], each.start[ticks[run_]], q[run_, None], before[run_],
                            after[run_], np.zeros(len(run_), dtype=bool), np.array([quantum / np.sqrt(12.0)]))
                )  # fmt: skip
    return found


def error_figures(stretches: Sequence[Stretch], n_transmissions: int) -> tuple[ErrorFigure, ...]:
    """Error of every signal before and after the repair, against speed, deflection, angle and time."""
    if not stretches:
        return ()
    states = np.concatenate([each.states for each in stretches])
    time = np.concatenate([each.time for each in stretches])
    found = []
    for column, axis in enumerate(stretches[0].axes):
        before = np.concatenate([each.before[:, column] - each.measured[:, column] for each in stretches])
        after = np.concatenate([each.after[:, column] - each.measured[:, column] for each in stretches])
        floor = np.concatenate([np.full(len(each.time), each.floor[column]) for each in stretches])
        for by, (unit, values) in quantities(states, time, axis, n_transmissions).items():
            bins = tuple(
                ErrorBin(low=six(low), high=six(high), centre=six(np.median(values[inside])),
                         before=rms(before[inside]), after=rms(after[inside]), floor=rms(floor[inside]))
                for low, high, inside in bins_of(by, values)
            )  # fmt: skip
            found.append(ErrorFigure(signal=_signal(stretches[0], axis), by=by, unit=unit, bins=bins))
    return tuple(found)


def trace_figures(stretches: Sequence[Stretch], longest: float) -> tuple[TraceFigure, ...]:
    """Every signal of the stretches [at most `longest` s] that are worst after and before the repair."""
    pieces = [piece for each in stretches for piece in _pieces(each, longest)]
    left = list(range(len(pieces)))
    found = []
    for by in STRETCHES:
        if not left:
            break
        worst = max(left, key=lambda i: _size(pieces[i], by))
        left.remove(worst)
        found.extend(_traces(pieces[worst], by))
    return tuple(found)


def trial_figures(judged: Sequence[Evaluation], tuned: Evaluation) -> tuple[Trial, ...]:
    """Causes and sets of causes with what speaks for them, best score first, each place once."""
    best: dict[frozenset[Location], Evaluation] = {}
    for each in sorted(judged, key=lambda each: each.score):
        best.setdefault(frozenset(each.fit.locations), each)
    ranked = list(best.values())[:TRIALS]
    found = []
    for each in ranked:
        behind, deviation = difference(each, ranked[0])
        left = each.mean_square / max(tuned.mean_square, 1e-12)
        found.append(
            Trial(effects=tuple(map(_member, each.fit.locations)), left=six(left), behind=six(behind),
                  behind_sd=six(deviation))
        )  # fmt: skip
    return tuple(found)


def screened_members(candidates: Sequence[Location], judged: Sequence[Evaluation]) -> tuple[Member, ...]:
    """Candidates that are in no trial."""
    fitted = {location for each in judged for location in each.fit.locations}
    return tuple(_member(location) for location in candidates if location not in fitted)


def untried_effects(candidates: Sequence[Location]) -> tuple[str, ...]:
    """Effects of the catalogue that are neither candidates nor found in the measurements themselves."""
    tried = {*MEASUREMENT_ONLY, *(location.name for location in candidates)}
    return tuple(name for name in EFFECTS if name not in tried)


def _member(location: Location) -> Member:
    return Member(effect=location.name, site=location.site, motor=location.motor)


def _pieces(stretch: Stretch, longest: float) -> list[Stretch]:
    """The stretch in pieces of at most `longest`, cut where a simulation starts anew if it ever does."""
    cuts = np.flatnonzero(stretch.restarts)
    cuts = cuts if len(cuts) else np.arange(len(stretch.time))
    begins = [int(cuts[0])]
    for this, following in pairwise([*cuts, len(stretch.time)]):
        if stretch.time[following - 1] - stretch.time[begins[-1]] > longest and this > begins[-1]:
            begins.append(int(this))
    return [
        Stretch(stretch.log, stretch.axes, stretch.time[a:b], stretch.states[a:b], stretch.measured[a:b],
                stretch.before[a:b], stretch.after[a:b], stretch.restarts[a:b], stretch.floor, stretch.torque)
        for a, b in pairwise([*begins, len(stretch.time)])
    ]  # fmt: skip


def _size(piece: Stretch, by: Literal["after", "before"]) -> float:
    """Squared error in units of the floor, summed over samples: short pieces do not win."""
    error = (getattr(piece, by) - piece.measured) / np.maximum(piece.floor, 1e-9)
    return float(np.sum(error**2))


def _traces(piece: Stretch, by: Literal["after", "before"]) -> list[TraceFigure]:
    every = max(1, -(-len(piece.time) // POINTS))
    begins = np.flatnonzero(piece.restarts)
    kept = np.arange(0, len(piece.time), every)
    restarts = tuple(int(np.searchsorted(kept, b)) for b in begins[1:] if b <= kept[-1])
    columns = {"measured": piece.measured, "before": piece.before, "after": piece.after}
    return [
        TraceFigure(
            log=piece.log, signal=_signal(piece, axis), worst=by, time=tuple(map(six, piece.time[kept])),
            restarts=restarts,
            **{name: tuple(map(six, values[kept, column])) for name, values in columns.items()},
        )
        for column, axis in enumerate(piece.axes)
    ]  # fmt: skip


def _signal(stretch: Stretch, axis: int) -> str:
    if not stretch.torque:
        return NAMES[axis]
    return "tau" if stretch.axes == (0,) else "tau_link" if axis == 0 else f"tau_{axis}"
