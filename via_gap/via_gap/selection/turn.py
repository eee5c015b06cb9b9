"""When a gap begins or ends: the time from which the same motion leaves another error.

Levels y (S,) are the logarithms of the mean squared errors of the segments of the tuned device. With the motion of each
segment (X: ranks of its angle, amplitude, speed and spring loads, and their squares) and a step at the time T

    y = X b + c [t >= T] + e,     t_c = c / (sd(c) C^(1/2)),   C = 1 + 2 sum_l max(r_l, 0)

has Student's distribution without a change; r_l are the correlations of neighbouring e. T is where |t_c| is largest,
and counts if its probability times the number of times compared is below the significance. A gap that grows because the
motion does is explained by X.

The part in which the gap is larger is diagnosed on its own, if the whole log has no named cause, or a main effect that
the other part refutes: there it makes the error larger. The answer of the part stands if the other part refutes it.
Source: largest F of a structural change, D. W. K. Andrews, Econometrica 61 (1993), with Bonferroni's bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.stats import rankdata
from scipy.stats import t as student
from via_core.signals import Array, Mask
from via_sim.effects import Effect

from via_gap.candidates.fit import Fit
from via_gap.residual.quantities import quantities
from via_gap.residual.segments import Segments
from via_gap.selection.evidence import Evaluation, significantly_worse
from via_gap.selection.experiment import Experiment
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.verdict import UNNAMED, Decision

FEWEST = 12  # segments of either part
ALIKE = 1e-9  # of a size: rounding


@dataclass(frozen=True, eq=False)
class Part:
    """The part of a log in which the gap is larger; [s] since its first sample."""

    log: str
    begin: float
    end: float
    whole: Experiment
    inside: Mask  # (S,) of all usable segments: whether in the part

    @property
    def segments(self) -> Segments:
        """The segments of the part."""
        (each,) = self.whole.segments
        valid = each.valid.copy()
        valid[np.flatnonzero(valid)[~self.inside]] = False
        return replace(each, valid=valid)

    def confines(self, fit: Fit) -> bool:
        """Whether the other part refutes the effects of a fit to this one."""
        problem = self.whole.everywhere()

        def evaluation(effects: tuple[Effect, ...]) -> Evaluation:
            squares = problem.squares(effects, fit.offsets)[~self.inside]
            return Evaluation(fit, squares, squares, self.whole.tuned.block)

        return significantly_worse(evaluation(fit.effects), evaluation(()))


def part_of(experiment: Experiment, decision: Decision) -> Part | None:
    """The part of a single log in which the gap is larger, if that is certain and `decision` may be due to it."""
    if len(experiment.segments) != 1 or experiment.folds is not None:
        return None
    part = _larger_gap(experiment) if decision.verdict in (*UNNAMED, "main_effect") else None
    return part if part is None or not decision.named or part.confines(decision.chosen.fit) else None


def _larger_gap(experiment: Experiment) -> Part | None:
    """The part of the only log in which the gap is larger, if that is certain."""
    problem, (segments,), fit = experiment.everywhere(), experiment.segments, experiment.tuned.fit
    levels = np.log(np.maximum(problem.squares(fit.effects, fit.offsets), ALIKE))
    motion = quantities(problem.views)
    time = motion.pop("time")
    order = np.argsort(time)
    found = turning_point(levels[order], np.array([values[order] for values in motion.values()]))
    if found is None:
        return None
    first, later = found
    turn, end = float(time[order][first]), float(segments.log.measured.time[-1] - segments.log.measured.time[0])
    inside = (time >= turn) if later else (time < turn)
    return Part(segments.log.name, turn if later else 0.0, end if later else turn, experiment, inside)


def turning_point(levels: Array, motion: Array) -> tuple[int, bool] | None:
    """First of the levels (S,) after the change, and whether they are higher then; None without a change.

    motion  (k, S) quantities of the motion of each segment
    """
    n = len(levels)
    ranks = np.array([2.0 * (rankdata(each) - 0.5) / n - 1.0 for each in motion if np.ptp(each) > 0.0]).reshape(-1, n)
    directions, sizes, _ = np.linalg.svd(np.vstack([np.ones(n), ranks, ranks**2]).T, full_matrices=False)
    basis = directions[:, sizes > ALIKE * sizes[0]]
    freedom = n - basis.shape[1] - 1
    turns = np.arange(FEWEST, n - FEWEST + 1)
    if freedom < FEWEST or not len(turns):
        return None
    left = levels - basis @ (basis.T @ levels)
    best = (0.0, 0, 0.0)
    for turn in turns:
        step = (np.arange(n) >= turn).astype(float)
        step -= basis @ (basis.T @ step)
        size = float(step @ step)
        if size > ALIKE * n:
            error = left - step * (step @ left) / size
            variance = max(float(error @ error), ALIKE) / freedom * _correlated(error)
            score = float(step @ left) / sqrt(size * variance)
            best = max(best, (abs(score), int(turn), score))
    certain = 2.0 * len(turns) * student.sf(best[0], freedom) < NUMBERS.significance
    return (best[1], best[2] > 0.0) if certain else None


def _correlated(error: Array) -> float:
    """C: the factor on the variance of a mean of these errors (S,)."""
    total, lags = max(float(error @ error), ALIKE), range(1, len(error) // 4)
    return 1.0 + 2.0 * sum(max(float(error[lag:] @ error[:-lag]) / total, 0.0) for lag in lags)
