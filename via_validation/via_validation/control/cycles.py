"""Division of a motion into cycles, with their periods and amplitudes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from via_core.signals import Array, Indices


@dataclass(frozen=True)
class Cycles:
    """Whole cycles of `value` (N,) at `time` (N,) [s], between its upward crossings of `level`."""

    time: Array
    value: Array
    level: float = 0.0

    @cached_property
    def first(self) -> Indices:
        """Samples (c + 1,) just before an upward crossing; c whole cycles."""
        x = self.value - self.level
        return np.asarray(np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0)))

    @property
    def crossings(self) -> Array:
        """(c + 1,) [s] times of the crossings, by linear interpolation."""
        at, x = self.first, self.value - self.level
        return self.time[at] + (self.time[at + 1] - self.time[at]) * x[at] / (x[at] - x[at + 1])

    @property
    def periods(self) -> Array:
        """(c,) [s] durations of the cycles."""
        return np.diff(self.crossings)

    def each(self, other: Array) -> list[Array]:
        """`other` (N, ..), sampled with the motion, cut into one piece per cycle."""
        return [other[a:b] for a, b in zip(self.first[:-1], self.first[1:], strict=True)]

    @property
    def swings(self) -> Array:
        """(c,) peak-to-peak amplitude of each cycle."""
        return np.array([np.ptp(piece) for piece in self.each(self.value)])


def relative_sd(values: Array) -> float:
    """Standard deviation over the magnitude of the mean [-]."""
    return float(np.std(values) / abs(np.mean(values)))
