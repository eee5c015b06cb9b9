"""The interval of a run in which an effect explains most: fits of effects that begin and end start there.

Each segment starts at its measured state, so an effect that acts for some time changes only the segments of that time.
The response of every segment to a small amount of the effect is taken as linear. The amounts that are tried are those
that are best for one segment. For each, the gain of every segment is computed, and the interval is the one with the
largest sum of gains. The gain is that of the loss of the fits, in which a segment that nothing explains does not hide
the others.

Source: largest sum of neighbours, J. Bentley, Programming pearls: algorithm design techniques, Communications of the
ACM 27 (1984).
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.candidates.fit import Fit
from via_gap.residual.residual_model import ResidualModel

Interval = tuple[float, float]


def best_interval(model: ResidualModel, base: Fit, effect: Effect, begins: Array) -> tuple[Interval, ...]:
    """The interval [s] in which some amount of `effect` improves `base` most; none if no amount does.

    effect  a small amount of it, at all times
    begins  (S,) of the segments of `model` [s since the run began]
    """
    row = model.row_or_none([effect], base.offsets)
    if row is None or len(begins) < 2:
        return ()
    change = model.residual([row])[0] - base.residual
    owner, order = model.segment_of_value(), np.argsort(begins)
    squares = np.bincount(owner, change**2)
    amounts = -np.bincount(owner, change * base.residual)[squares > 0.0] / squares[squares > 0.0]
    before, best = model.losses(base.residual), 0.0
    found: tuple[Interval, ...] = ()
    for amount in amounts:
        gains = (before - model.losses(base.residual + amount * change))[order]
        total, first, last = largest_sum(gains)
        if total > best:
            step = float(np.median(np.diff(begins[order])))
            best, found = total, ((max(float(begins[order[first]]), 0.0), float(begins[order[last]]) + step),)
    return found


def largest_sum(values: Array) -> tuple[float, int, int]:
    """Largest sum of neighbours in values (N,), with the first and the last of them."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    least = np.minimum.accumulate(sums[:-1])
    last = int(np.argmax(sums[1:] - least))
    first = int(np.argmin(sums[: last + 1]))
    return float(sums[last + 1] - sums[first]), first, last
