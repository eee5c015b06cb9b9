"""Measures of a method in one case: a method, a joint and a level of noise, over all seeds.

accuracy      relative RMS error of the total stiffness after `CONVERGED`: RMS of the error over RMS of the truth; all
              samples count, whatever their status, at the present deflection
convergence   time after which the relative RMS error of every second stays within 10 %; infinite if it does not
coverage      share of samples with status OK whose 95 % interval contains the truth
sd / scatter  RMS of the reported standard deviations over RMS of the scatter between seeds, status OK, after
              `CONVERGED`
sd / error    RMS of the reported standard deviations over RMS of the error, which includes friction and truncation
trusted       share of samples after the first two seconds with status OK
wrong motors  worst accuracy with nominal inertia and damping wrong by +-20 %, all four combinations
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from via_core.metrics import WIDTH_95
from via_core.signals import Array
from via_core.status import Status
from via_estimators.contract import Estimates

from via_validation.compare.experiment import RATE

CONVERGED = 10.0  # [s] after which accuracy counts
START = 2.0  # [s] after which the status should be OK: longest window and fade-in
WITHIN = 0.1  # [-] relative error that counts as converged
NOISELESS = 1e-9  # [-] scatter over truth below which the scatter counts as zero


@dataclass(frozen=True)
class Run:
    """An output of one seed: time, truth, value, standard deviation, whether OK; all (N,)."""

    time: Array
    truth: Array
    value: Array
    sd: Array
    ok: Array

    @classmethod
    def of(cls, estimates: Estimates, output: str, time: Array, truth: Array) -> Run:
        """The output of these estimates."""
        return cls(time, truth, *estimates.column(output), estimates.status == Status.OK)


@dataclass(frozen=True)
class Figures:
    """The measures of this file; NaN if a measure is undefined."""

    accuracy: float
    convergence: float  # [s] median over the seeds
    coverage: float
    over_scatter: float
    over_error: float
    trusted: float


def figures(runs: Sequence[Run]) -> Figures:
    """Measures of one case, from runs with different seeds."""
    values = np.stack([run.value for run in runs])
    ok = np.stack([run.ok for run in runs])
    reported = np.stack([run.sd for run in runs])
    time, truth = runs[0].time, runs[0].truth
    late = time >= CONVERGED
    covered = np.abs(values - truth) <= WIDTH_95 * reported
    return Figures(
        accuracy=accuracy(runs),
        convergence=float(np.median([convergence(run) for run in runs])),
        coverage=float(covered[ok].mean()) if ok.any() else nan,
        over_scatter=_over_scatter(values[:, late], reported[:, late], ok[:, late], truth[late]),
        over_error=_over_error(values[:, late] - truth[late], reported[:, late], ok[:, late]),
        trusted=float(ok[:, time >= START].mean()),
    )


def accuracy(runs: Sequence[Run]) -> float:
    """Relative RMS error of all runs together."""
    late = runs[0].time >= CONVERGED
    errors = np.stack([(run.value - run.truth)[late] for run in runs])
    return float(np.sqrt(np.mean(errors**2) / np.mean(runs[0].truth[late] ** 2)))


def convergence(run: Run) -> float:
    """Time [s] after which every second's relative RMS error is within 10 %; inf if the last one is not."""
    seconds = len(run.time) // round(RATE)
    shape = (seconds, round(RATE))
    error = np.mean((run.value - run.truth)[: seconds * shape[1]].reshape(shape) ** 2, axis=1)
    size = np.mean(run.truth[: seconds * shape[1]].reshape(shape) ** 2, axis=1)
    bad = np.flatnonzero(error > WITHIN**2 * size)
    if not len(bad):
        return 0.0
    return inf if bad[-1] == seconds - 1 else float(bad[-1] + 1)


def _over_scatter(values: Array, reported: Array, ok: Array, truth: Array) -> float:
    """sd / scatter over the samples at which every seed is OK; NaN for fewer than two seeds or without scatter."""
    together = ok.all(axis=0)
    if len(values) < 2 or not together.any():
        return nan
    scatter = np.mean(np.var(values[:, together], axis=0, ddof=1))
    if scatter <= np.mean((NOISELESS * truth) ** 2):
        return nan
    return float(np.sqrt(np.mean(reported[:, together] ** 2) / scatter))


def _over_error(errors: Array, reported: Array, ok: Array) -> float:
    """sd / error; NaN without samples of status OK or without error."""
    size = np.mean(errors[ok] ** 2) if ok.any() else 0.0
    return float(np.sqrt(np.mean(reported[ok] ** 2) / size)) if size > 0.0 else nan
