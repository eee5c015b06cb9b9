"""Fewer segments to search on: neighbouring pairs spread evenly over the logs, and those in which most is unexplained.

What ranks candidates and finds their numbers roughly needs no more data than this, however long the logs are; what is
kept is fitted to all segments and judged on those held out.
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array

from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Indices

EVEN = 28  # segments spread over the logs
BUSIEST = 8  # segments with the largest errors besides


def subset(problem: ResidualModel, residual: Array) -> tuple[ResidualModel, Indices]:
    """The problem to search on, and where its values stand in a residual (R,); all of it where that is not much.

    Segments of servos are few and long, and to motors without an encoder the whole log leads whichever are compared:
    then nothing is left out.
    """
    counts = [len(view.chosen) for view in problem.views]
    seen = all(all(view.segments.log.motors_seen) for view in problem.views)
    if problem.device.drive == "servo" or not seen or sum(counts) < 1.5 * (EVEN + BUSIEST):
        return problem, np.arange(len(residual))
    excess = problem.per_segment(residual)
    pair = np.concatenate([np.arange(n) // 2 + 10**6 * i for i, n in enumerate(counts)])  # of no two logs
    numbers, which = np.unique(pair, return_inverse=True)
    kept = np.zeros(len(numbers), dtype=bool)
    kept[np.linspace(0, len(numbers) - 1, EVEN // 2).round().astype(int)] = True
    heights = np.where(kept, -np.inf, np.bincount(which, excess))
    kept[np.argsort(heights)[-BUSIEST // 2 :]] = True
    ends = np.cumsum(counts)
    return problem.part([np.flatnonzero(kept[which[e - n : e]]) for e, n in zip(ends, counts, strict=True)])
