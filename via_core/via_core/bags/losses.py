"""Lost samples, counted by their stamps, for any pattern of losses.

A publisher with a steady period leaves steps between stamps that are whole multiples of it. The period is the mean of
the shortest steps; a step of n periods lacks n - 1 samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from via_core.signals import Array

SHORTEST = 0.01  # quantile of the steps from which the period is sought
STEADY = 0.15  # [periods] largest RMS distance of steps from whole multiples, beyond which nothing can be counted
LONG = 10  # periods; shorter steps show whether there is a period
NOTABLE = 1e-3  # smallest share of lost samples that is reported


class Losses(NamedTuple):
    """Samples lost: their number, share of all that were sent, the longest row of them, and the period [s]."""

    lost: int
    share: float
    longest: int
    period: float


def losses(time: Array) -> Losses | None:
    """Samples lost between stamps (N,) [s], N >= 50, that increase; None without notable loss or without a period."""
    steps = np.diff(time)
    if len(steps) < 49:
        return None
    period = float(np.quantile(steps, SHORTEST))
    for _ in range(5):
        near = (steps > 0.5 * period) & (steps < 1.5 * period)
        if not near.any():
            return None
        period = float(steps[near].mean())
    multiples = np.maximum(np.rint(steps / period), 1.0)
    short = multiples <= LONG
    if float(np.sqrt(np.mean((steps[short] / period - multiples[short]) ** 2))) > STEADY:
        return None
    lost = int((multiples - 1.0).sum())
    share = lost / (lost + len(time))
    if share < NOTABLE:
        return None
    return Losses(lost, share, int(multiples.max()) - 1, period)
