"""Fair times on a busy machine: contenders take turns, and medians are of what was measured side by side.

What counts is the time of the processor that this thread used, so that others waiting for it do not count; what they do
to caches does. Everything timed here is one thread.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from time import thread_time


@dataclass(frozen=True)
class Contender:
    """Something to time: `run` does `count` samples' work."""

    count: int
    run: Callable[[], object]


@dataclass(frozen=True)
class Times:
    """Seconds per sample, one per turn, in the order of the turns."""

    seconds: tuple[float, ...]

    @property
    def nanoseconds(self) -> float:
        """Median per sample [ns]."""
        return 1e9 * median(self.seconds)

    def over(self, other: Times) -> float:
        """Median over the turns of this one's time divided by the other's in the same turn."""
        return median(mine / theirs for mine, theirs in zip(self.seconds, other.seconds, strict=True))


def take_turns(contenders: Mapping[str, Contender], turns: int) -> dict[str, Times]:
    """Times of each, after a first round that compiles and warms caches and does not count."""
    taken: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(turns + 1):
        for name, contender in contenders.items():
            begin = thread_time()
            contender.run()
            if turn:
                taken[name].append((thread_time() - begin) / contender.count)
    return {name: Times(tuple(seconds)) for name, seconds in taken.items()}
