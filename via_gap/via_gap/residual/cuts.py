"""Where a log is cut into segments, and which segments show one rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array, Indices, Mask

RESTING = 4.0  # times the noise of a sample to either side: an angle that is further away has moved
EDGE = 1e-3  # [s] by which a segment may extend beyond a usable interval


def begins(known: Mask, ticks: int, every: int) -> Indices:
    """(S,) ticks where segments begin, multiples of `every`: 0, then each time the first whose state is known.

    Segments do not overlap. Where no sample is lost, each begins where the one before ends.
    """
    places = every * np.flatnonzero(known[: len(known) - ticks : every])
    found = [0]
    while (k := np.searchsorted(places, found[-1] + ticks)) < len(places):
        found.append(places[k])
    return np.array(found, dtype=np.intp)


def inside(begin: Array, span: float, usable: Sequence[tuple[float, float]]) -> Mask:
    """(S,) whether segments from `begin` [s] with length `span` [s] lie within one of the usable intervals."""
    within = [(low - EDGE <= begin) & (begin + span <= high + EDGE) for low, high in usable]
    return np.any(within, axis=0) if within else np.zeros(len(begin), dtype=np.bool_)


def rest_from(angles: Array, noise: Array) -> Indices:
    """(S,) first of the neighbouring segments in which all axes (S, n + 1, a) stay within a range of `noise` (a,)."""
    low, high = angles.min(axis=1), angles.max(axis=1)
    found = np.arange(len(angles))
    for k in range(1, len(angles)):
        rest = slice(found[k - 1], k + 1)
        if np.all(high[rest].max(axis=0) - low[rest].min(axis=0) <= noise):
            found[k] = found[k - 1]
    return found
