"""A multisine reference, which excites a joint at a few known frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite, pi, sin

import numpy as np
from numba import njit
from via_core.signals import Array, locked

from via_controllers.contract import require


@dataclass(frozen=True)
class Multisine:
    """r(t) = mean + sum_i amplitude_i sin(2 pi frequency_i t). Raises ParameterError for frequencies <= 0."""

    mean: float  # [rad]
    amplitudes: tuple[float, ...]  # [rad]
    frequencies: tuple[float, ...]  # [Hz]

    def __post_init__(self) -> None:
        require(
            len(self.amplitudes) == len(self.frequencies),
            f"as many amplitudes as frequencies, got {len(self.amplitudes)} and {len(self.frequencies)}",
        )
        for value in (self.mean, *self.amplitudes, *self.frequencies):
            require(isfinite(value), f"a multisine needs finite numbers, got {value}")
        require(all(f > 0.0 for f in self.frequencies), f"frequencies must be > 0 Hz, got {self.frequencies}")

    def at(self, time: float) -> float:
        """r [rad] at `time` [s] since the start."""
        return float(multisine(self.mean, self.tones, time))

    @cached_property
    def tones(self) -> Array:
        """Amplitudes and frequencies (2, k)."""
        return locked(np.array([self.amplitudes, self.frequencies], dtype=np.float64), "tones")


@njit(cache=True, error_model="numpy")
def multisine(mean: float, tones: Array, time: float) -> float:
    """`Multisine.at` for `Multisine.tones`."""
    total = 0.0
    for i in range(tones.shape[1]):
        total += tones[0, i] * sin(2.0 * pi * tones[1, i] * time)
    return mean + total
