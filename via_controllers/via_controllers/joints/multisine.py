"""A multisine reference, which excites a joint at a few known frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, pi, sin

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
        return self.mean + sum(
            a * sin(2.0 * pi * f * time) for a, f in zip(self.amplitudes, self.frequencies, strict=True)
        )
