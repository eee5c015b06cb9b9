"""Subset of the segments for the search: pairs at even distances in the logs, and pairs with the largest errors.

It suffices for the ranking of candidates and for rough fits. Candidates that are kept are fitted to all segments.
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array, Indices

from via_gap.residual.residual_model import ResidualModel

EVEN = 28  # segments at even distances
BUSIEST = 8  # further segments with the largest errors


def subset(problem: ResidualModel, residual: Array) -> tuple[ResidualModel, Indices]:
    """The residual model of the subset, and the indices of its values in a residual (R,).

    All segments stay if they are few, with servos, whose segments are long, and with a motor without an encoder, whose
    state requires the simulation of the whole log anyway.
    """
    counts = [len(view.chosen) for view in problem.views]
    seen = all(all(view.segments.log.motors_seen) for view in problem.views)
    if problem.device.drive == "servo" or not seen or sum(counts) < 1.5 * (EVEN + BUSIEST):
        return problem, np.arange(len(residual))
    excess = problem.per_segment(residual)
    pair = np.concatenate([np.arange(n) // 2 + 10**6 * i for i, n in enumerate(counts)])  # numbers differ between logs
    numbers, which = np.unique(pair, return_inverse=True)
    kept = np.zeros(len(numbers), dtype=bool)
    kept[np.linspace(0, len(numbers) - 1, EVEN // 2).round().astype(int)] = True
    heights = np.where(kept, -np.inf, np.bincount(which, excess))
    kept[np.argsort(heights)[-BUSIEST // 2 :]] = True
    ends = np.cumsum(counts)
    return problem.part([np.flatnonzero(kept[which[e - n : e]]) for e, n in zip(ends, counts, strict=True)])
