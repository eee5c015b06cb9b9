"""Times from the publication of a sample to the arrival of its command."""

from __future__ import annotations

import time
from collections import OrderedDict

import numpy as np

RECENT = 1024  # samples whose answers are counted
RESOLUTION = 10_000  # [ns] of the histogram
LONGEST = 10_000  # [RESOLUTION] of the histogram; longer times count as this one, but for the largest


class RoundTrips:
    """Statistics of all round trips since it was made, in memory of constant size."""

    def __init__(self) -> None:
        self.count = 0  # of samples that were answered; each counts once
        self.largest = 0.0  # [ms]
        self._sent: OrderedDict[int, int] = OrderedDict()  # [ns] time of publication by stamp, without an answer so far
        self._counts = np.zeros(LONGEST + 1, dtype=np.int64)

    def sent(self, stamp: int) -> None:
        """The sample with this stamp [ns] is published now."""
        self._sent[stamp] = time.perf_counter_ns()
        if len(self._sent) > RECENT:
            self._sent.popitem(last=False)

    def answered(self, stamp: int) -> None:
        """A command with this stamp [ns] arrives now."""
        sent = self._sent.pop(stamp, None)
        if sent is None:
            return
        passed = time.perf_counter_ns() - sent
        self.count += 1
        self.largest = max(self.largest, 1e-6 * passed)
        self._counts[min(passed // RESOLUTION, LONGEST)] += 1

    def percentile(self, share: float) -> float:
        """The time [ms] that this share [%] of the round trips does not exceed, rounded up; NaN without any."""
        if not self.count:
            return float("nan")
        rank = np.searchsorted(np.cumsum(self._counts), 1e-2 * share * self.count)
        return min(1e-6 * RESOLUTION * float(rank + 1), self.largest)
