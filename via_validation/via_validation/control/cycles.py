"""A motion cut into cycles: where it rises through a level, how long each takes, how far each swings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array


@dataclass(frozen=True)
class Cycles:
    """`value` (N,) sampled at `time` (N,) [s], in whole cycles between its rising passes through `level`."""

    time: Array
    value: Array
    level: float = 0.0

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """Samples (c + 1,) just before a rise; c whole cycles."""
        x = self.value - self.level
        return np.asarray(np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0)))

    @property
    def rises(self) -> Array:
        """(c + 1,) [s] by straight lines between samples."""
        at, x = self.first, self.value - self.level
        return self.time[at] + (self.time[at + 1] - self.time[at]) * x[at] / (x[at] - x[at + 1])

    @property
    def periods(self) -> Array:
        """(c,) [s]."""
        return np.diff(self.rises)

    def each(self, other: Array) -> list[Array]:
        """`other` (N, ..) sampled with the motion, one piece per cycle."""
        return [other[a:b] for a, b in zip(self.first[:-1], self.first[1:], strict=True)]

    @property
    def swings(self) -> Array:
        """(c,) peak to peak of each cycle."""
        return np.array([np.ptp(piece) for piece in self.each(self.value)])


def spread(values: Array) -> float:
    """Standard deviation over mean [-]."""
    return float(np.std(values) / abs(np.mean(values)))
