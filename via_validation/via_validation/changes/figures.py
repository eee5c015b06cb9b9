"""Measures of a method under a schedule, over all seeds, in the interval in which the schedule's errors count.

Source of the three figures of the field: M. van de Ruit, W. Mugge and A. C. Schouten, Quantifying joint stiffness
during movement (ICNR 2020): bias, random error over simulations, and the fastest change that can be captured. They use
a square wave; here a step and sines show the last one.

bias          RMS over time of the mean error of the seeds, relative to the RMS of the truth, without the share that the
              random error has in a mean of so few seeds
random error  RMS over time of the standard deviation between seeds, relative likewise
missed        |1 - H| of a sine: H is the complex gain from the change to the estimated change. 0: followed exactly; 1:
              not noticed. First-order tracking misses 1/sqrt(2) at its bandwidth
followed      time after a step from which the estimated factor stays within 10 % of the new one, median over seeds
coverage      share of the samples with status OK whose 95 % interval contains the truth
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan, sqrt

import numpy as np
from via_core.metrics import WIDTH_95
from via_core.signals import Array

from via_validation.changes.schedules import AMPLITUDE, STEP_SIZE, STEP_TIME, Schedule
from via_validation.compare.decision import TRUSTED
from via_validation.compare.figures import WITHIN, Run

BANDWIDTH = 1.0 / sqrt(2.0)  # [-] missed at most by a method that follows
SHORT = 0.05  # [s] over which the factor of a step is averaged


@dataclass(frozen=True)
class Outcome:
    """Measures of a method on a device under a schedule; NaN if a measure is undefined."""

    error: float  # [-] relative RMS error
    coverage: float  # [-]
    ok: float  # [-] share of samples with status OK
    bias: float  # [-]
    random: float  # [-]
    missed: float  # [-] of a sine
    followed: float  # [s] after a step
    seeds: int


def outcome(schedule: Schedule, runs: Sequence[Run], unchanged: Array) -> Outcome:
    """The measures of runs with different seeds; `unchanged` (n,) is the truth without the schedule."""
    part = schedule.counts(runs[0].time)
    truth = runs[0].truth[part]
    size = float(np.mean(truth**2))
    errors = np.stack([run.value[part] - truth for run in runs])
    ok = np.stack([run.ok[part] for run in runs])
    covered = np.abs(errors) <= WIDTH_95 * np.stack([run.sd[part] for run in runs])
    bias = random = nan
    if len(runs) > 1:
        variance = float(np.mean(np.var(errors, axis=0, ddof=1)))
        mean_square = float(np.mean(np.mean(errors, axis=0) ** 2))
        bias, random = sqrt(max(mean_square - variance / len(runs), 0.0) / size), sqrt(variance / size)
    return Outcome(
        error=sqrt(float(np.mean(errors**2)) / size),
        coverage=float(covered[ok].mean()) if ok.any() else nan,
        ok=float(ok.mean()),
        bias=bias,
        random=random,
        missed=missed(schedule, runs, unchanged) if schedule.frequency else nan,
        followed=float(np.median([followed(run, unchanged) for run in runs])) if schedule.size != 1.0 else nan,
        seeds=len(runs),
    )


def missed(schedule: Schedule, runs: Sequence[Run], unchanged: Array) -> float:
    """|1 - H| at the schedule's frequency, by least squares on value = unchanged (mean + in phase + quadrature)."""
    time = runs[0].time
    part = schedule.counts(time)
    phase = 2.0 * np.pi * schedule.frequency * time[part]
    columns = unchanged[part, None] * np.stack([np.ones(len(phase)), np.sin(phase), np.cos(phase)], axis=1)
    value = np.mean([run.value[part] for run in runs], axis=0)
    _, inside, quadrature = np.linalg.lstsq(columns, value, rcond=None)[0]
    return float(np.hypot(1.0 - inside / AMPLITUDE, quadrature / AMPLITUDE))


def factors(run: Run, unchanged: Array) -> tuple[Array, Array]:
    """Ends [s] of pieces of SHORT, and the estimated factor in each, by least squares on the unchanged truth."""
    count = max(1, round(SHORT / float(np.median(np.diff(run.time)))))
    pieces = len(run.time) // count
    value, base = (each[: pieces * count].reshape(pieces, count) for each in (run.value, unchanged))
    return run.time[count - 1 : pieces * count : count], np.sum(value * base, axis=1) / np.sum(base**2, axis=1)


def followed(run: Run, unchanged: Array) -> float:
    """Time [s] after the step from which the estimated factor stays within 10 % of the new one; inf if it does not."""
    time, found = factors(run, unchanged)
    off = np.flatnonzero((time > STEP_TIME) & (np.abs(found / STEP_SIZE - 1.0) > WITHIN))
    if not len(off):
        return 0.0
    return inf if off[-1] == len(time) - 1 else float(time[off[-1]] - STEP_TIME)


def fastest(sines: dict[float, tuple[float, float]]) -> float:
    """Highest frequency [Hz] up to which every sine is followed with status OK; 0 if none is.

    sines  by frequency what is missed, and the share of samples with status OK: others are no estimates
    """
    highest = 0.0
    for frequency, (lost, ok) in sorted(sines.items()):
        if not (lost <= BANDWIDTH and ok >= TRUSTED):
            break
        highest = frequency
    return highest
