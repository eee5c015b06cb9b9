"""Samples in the order of their stamps: the largest part of a recording in which time increases.

One stamp that is far in the future makes all later ones seem old; dropping every stamp that is not later than all
before would lose the recording. The longest increasing subsequence (Fredman, On computing the length of longest
increasing subsequences, Discrete Mathematics 11, 1975) loses that stamp alone.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from via_core.signals import Mask


class Ordered(NamedTuple):
    """kept (N,) samples in order; how many others have the stamp of the last one, or are out of order."""

    kept: Mask
    repeated: int
    backward: int


def ordered(stamps: NDArray[np.float64] | NDArray[np.int64]) -> Ordered:
    """The most samples with increasing stamps (N,), of equal stamps the first; stamps that are not finite are left out.

    In n log n steps: `least[k]` is the smallest last stamp of an increasing sequence of k + 1 stamps so far.
    """
    known = np.flatnonzero(np.isfinite(stamps))
    values, kept = stamps[known], np.zeros(len(stamps), dtype=np.bool_)
    if np.all(values[1:] > values[:-1]):
        kept[known] = True
        return Ordered(kept, 0, 0)
    least: list[float] = []
    last: list[int] = []  # index of that stamp
    before = np.full(len(values), -1)  # index of the one before in its sequence
    for i, stamp in enumerate(values.tolist()):
        k = bisect_left(least, stamp)
        if k == len(least):
            least.append(stamp)
            last.append(i)
        elif stamp < least[k]:
            least[k], last[k] = stamp, i
        else:
            continue
        before[i] = last[k - 1] if k else -1
    at = last[-1]
    while at >= 0:
        kept[known[at]] = True
        at = before[at]
    taken = kept[known]
    latest = np.maximum.accumulate(np.where(taken, values, values.min()))
    repeated = int(np.count_nonzero(~taken & (values == latest)))
    return Ordered(kept, repeated, int(np.count_nonzero(~taken)) - repeated)
