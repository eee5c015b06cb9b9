"""The numbers behind a report's pictures, computed from what the diagnosis already has.

Short shots are compared as the gap is: what a start known only as well as the sensors tell can explain is not counted,
so that 'simulated' is the measured angle less the error that remains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from via_core.devices import Device
from via_core.signals import Array
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect
from via_sim.torques import EXTERNAL

from via_gap.equation_bench import EquationBench
from via_gap.evidence import Judged, difference
from via_gap.figures import (
    ErrorBin,
    ErrorFigure,
    Figures,
    JointSketch,
    Member,
    Quantity,
    ResidualBin,
    ResidualFigure,
    TraceFigure,
    Trial,
)
from via_gap.log import JointLog
from via_gap.measured import NAMES
from via_gap.places import OF_READINGS, Place
from via_gap.problem import Problem
from via_gap.repaired import repaired_device
from via_gap.replayed import simulated_log
from via_gap.residuals import Residual
from via_gap.shots import Indices, Shots

BINS = 10  # of equal count
TIME_BINS = 20  # of equal length
FEWEST = 3  # samples of a bin that is shown
STRETCH = 2.0  # [s] of shots that are drawn, and
FREE_STRETCH = 5.0  # [s] of a free run
POINTS = 240  # of a trace
STRETCHES: tuple[Literal["after", "before"], ...] = ("after", "before", "after")  # each the worst of what is left
TRIALS = 16  # that are listed


@dataclass(frozen=True, eq=False)
class Stretch:
    """Held-out samples in a row.

    time      (N,) [s] since the log began
    states    (N, 6) [rad, rad/s] smoothed, NaN: not seen
    measured, before, after  (N, a) [rad] of `axes`; of equations the drive's torque [N m] as sent and as a model needs
    restarts  (N,) whether the simulation starts anew at a sample
    floor     (a,) rms that the sensors explain, in the same unit
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
    device: Device,
    shots: Sequence[Shots],
    held: Sequence[Indices],
    residuals: Sequence[Sequence[Residual]],
    numbers: Device,
    judged: Problem,
    before: Judged,
    tuned: Judged,
    chosen: Judged,
    trials: Sequence[Judged],
    candidates: Sequence[Place],
    by: Literal["shots", "free run", "equations"],
) -> Figures:
    """All pictures of one diagnosis.

    numbers  the device with the numbers that `residuals` were computed with
    before, tuned, chosen  the device as filed, with its numbers moved, and the repair, judged on `held`
    trials   every cause and set of causes that was fitted to the end
    by       how the gap was measured
    """
    if by == "shots":
        longest, stretches = STRETCH, shot_stretches(judged, before.residual, chosen.residual)
    elif by == "equations":
        longest, stretches = FREE_STRETCH, equation_stretches(judged, before.residual, chosen.residual)
    else:
        moved = repaired_device(device, judged.nuisances, chosen.fit.deviations)
        longest, stretches = FREE_STRETCH, free_stretches(device, moved, chosen.fit.effects, shots, held)
    return Figures(
        joint=joint_sketch(shots[0].log),
        residuals=residual_figures(shots, residuals, numbers),
        errors=error_figures(stretches, device.n_transmissions),
        traces=trace_figures(stretches, longest),
        trials=trial_figures(trials, tuned),
        screened=screened_members(candidates, trials) if trials else (),
        untried=untried_effects(candidates),
    )


def joint_sketch(log: JointLog) -> JointSketch:
    """What a picture of the log's joint needs."""
    return JointSketch(
        arrangement=log.device.arrangement,
        drive="servo" if log.device.drive == "servo" else "torque",
        motors_seen=log.motors_seen,
        torque_seen=log.torque_seen,
    )


def residual_figures(
    shots: Sequence[Shots], residuals: Sequence[Sequence[Residual]], device: Device
) -> tuple[ResidualFigure, ...]:
    """Residual of every equation against speed, deflection, angle and time; none where a log allows no equation."""
    if not residuals or not all(residuals):
        return ()
    found = []
    for k, first in enumerate(residuals[0]):
        torque = np.concatenate([each[k].torque for each in residuals])
        floor = np.concatenate([each[k].floor for each in residuals])
        states = np.concatenate([s.start[each[k].centre] for s, each in zip(shots, residuals, strict=True)])
        time = np.concatenate([each[k].centre / s.rate for s, each in zip(shots, residuals, strict=True)])
        for by, (unit, values) in _quantities(states, time, first.axis, device.n_transmissions).items():
            along = torque * np.sign(states[:, 3 + first.axis]) if by == "speed" else torque
            bins = tuple(
                ResidualBin(low=_six(low), high=_six(high), centre=_six(np.median(values[inside])),
                            mean=_six(np.mean(along[inside])), rms=_rms(torque[inside]), floor=_rms(floor[inside]))
                for low, high, inside in _bins(by, values)
            )  # fmt: skip
            found.append(ResidualFigure(equation=first.name, by=by, unit=unit, bins=bins))
    return tuple(found)


def shot_stretches(problem: Problem, before: Array, after: Array) -> list[Stretch]:
    """Neighbouring shots of a problem, with whitened residuals (R,) of two simulations."""
    found, begin = [], 0
    for bench in problem.benches:
        shots, size = bench.shots, len(bench.chosen) * bench.size
        shape = (len(bench.chosen), -1, len(shots.axes))
        errors = [each[begin : begin + size].reshape(shape) * shots.noise for each in (before, after)]
        begin += size
        for run in np.split(np.arange(len(bench.chosen)), np.flatnonzero(np.diff(bench.chosen) > 1) + 1):
            measured = shots.measured[bench.chosen[run]]
            bins = measured.shape[1]
            ticks = (shots.begin[bench.chosen[run]][:, None] + shots.every * np.arange(1, bins + 1)).ravel()
            flat = measured.reshape(-1, len(shots.axes))
            first, second = (flat - each[run].reshape(flat.shape) for each in errors)
            restarts = np.arange(len(ticks)) % bins == 0
            found.append(
                Stretch(shots.log.name, shots.axes, ticks / shots.rate, shots.start[ticks], flat, first, second,
                        restarts, shots.noise)
            )  # fmt: skip
    return found


def equation_stretches(problem: Problem, before: Array, after: Array) -> list[Stretch]:
    """Neighbouring shots of a problem of equations, with what two models lack (R,), window by window."""
    found, begin = [], 0
    for bench in problem.benches:
        assert isinstance(bench, EquationBench)
        shots, size = bench.shots, bench.first.size
        missing = [each[begin : begin + size].reshape(bench.first.shape) * bench.floor for each in (before, after)]
        begin += size
        sent = bench.over(shots.commands[:, EXTERNAL], 0)
        for run in np.split(np.arange(len(bench.chosen)), np.flatnonzero(np.diff(bench.chosen) > 1) + 1):
            ticks = (bench.first[run] + bench.weights.shape[1] // 2).ravel()
            flat = sent[run].reshape(-1, 1)
            first, second = (flat + each[run].reshape(-1, 1) for each in missing)
            found.append(
                Stretch(shots.log.name, (0,), ticks / shots.rate, shots.start[ticks], flat, first, second,
                        np.zeros(len(ticks), dtype=bool), np.array([bench.floor]), True)
            )  # fmt: skip
    return found


def free_stretches(
    nominal: Device, repaired: Device, effects: Sequence[Effect], shots: Sequence[Shots], chosen: Sequence[Indices]
) -> list[Stretch]:
    """Held-out stretches of logs that are simulated from beginning to end; the link angle only."""
    found = []
    for each, which in zip(shots, chosen, strict=True):
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
        shot = np.clip(np.searchsorted(each.time, time, side="right") - 1, 0, len(each) - 1)
        inside = np.flatnonzero(np.isin(shot, which))
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
        for by, (unit, values) in _quantities(states, time, axis, n_transmissions).items():
            bins = tuple(
                ErrorBin(low=_six(low), high=_six(high), centre=_six(np.median(values[inside])),
                         before=_rms(before[inside]), after=_rms(after[inside]), floor=_rms(floor[inside]))
                for low, high, inside in _bins(by, values)
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


def trial_figures(judged: Sequence[Judged], tuned: Judged) -> tuple[Trial, ...]:
    """Causes and sets of causes with what speaks for them, best score first, each place once."""
    best: dict[frozenset[Place], Judged] = {}
    for each in sorted(judged, key=lambda each: each.score):
        best.setdefault(frozenset(each.fit.places), each)
    ranked = list(best.values())[:TRIALS]
    found = []
    for each in ranked:
        behind, deviation = difference(each, ranked[0])
        left = each.mean_square / max(tuned.mean_square, 1e-12)
        found.append(
            Trial(effects=tuple(map(_member, each.fit.places)), left=_six(left), behind=_six(behind),
                  behind_sd=_six(deviation))
        )  # fmt: skip
    return tuple(found)


def screened_members(candidates: Sequence[Place], judged: Sequence[Judged]) -> tuple[Member, ...]:
    """Candidates that are in no trial."""
    fitted = {place for each in judged for place in each.fit.places}
    return tuple(_member(place) for place in candidates if place not in fitted)


def untried_effects(candidates: Sequence[Place]) -> tuple[str, ...]:
    """Effects of the catalogue that are no candidate at all, nor seen in the readings."""
    told = {*OF_READINGS, *(place.name for place in candidates)}
    return tuple(name for name in EFFECTS if name not in told)


def _member(place: Place) -> Member:
    return Member(effect=place.name, site=place.site, motor=place.motor)


def _quantities(states: Array, time: Array, axis: int, n_transmissions: int) -> Mapping[Quantity, tuple[str, Array]]:
    """Unit and values (N,) of what residuals and errors are held against; only what was seen throughout."""
    against: dict[Quantity, tuple[str, Array]] = {
        "speed": ("rad/s", np.abs(states[:, 3 + axis])),
        "deflection": ("rad", states[:, 0] - states[:, min(max(axis, 1), max(n_transmissions, 1))]),
        "angle": ("rad", states[:, 0]),
        "time": ("s", time),
    }
    if not n_transmissions:
        del against["deflection"]
    return {by: pair for by, pair in against.items() if np.isfinite(pair[1]).all()}


def _bins(by: Quantity, values: Array) -> list[tuple[float, float, NDArray[np.bool_]]]:
    """Ranges and who is in them; those that hold next to nothing are left out."""
    if by == "time":
        edges = np.linspace(values.min(), values.max(), TIME_BINS + 1)
    else:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    found = []
    for k, (low, high) in enumerate(pairwise(edges)):
        inside = (values >= low) & ((values < high) if k < len(edges) - 2 else (values <= high))
        if np.sum(inside) >= FEWEST:
            found.append((float(low), float(high), inside))
    return found


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
            log=piece.log, signal=_signal(piece, axis), worst=by, time=tuple(map(_six, piece.time[kept])),
            restarts=restarts,
            **{name: tuple(map(_six, values[kept, column])) for name, values in columns.items()},
        )
        for column, axis in enumerate(piece.axes)
    ]  # fmt: skip


def _signal(stretch: Stretch, axis: int) -> str:
    return "tau" if stretch.torque else NAMES[axis]


def _rms(values: Array) -> float:
    return _six(float(np.sqrt(np.mean(values**2))))


def _six(value: float) -> float:
    """Six digits: more than any picture shows, and short in JSON."""
    return float(f"{value:.6g}")
