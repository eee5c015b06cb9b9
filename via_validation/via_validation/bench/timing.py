"""Fair timing on a busy machine: contenders alternate, and ratios are medians over turns.

Times are processor times of this thread. Other processes therefore matter only through the caches. Everything timed
here uses one thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import thread_time

from via_bringup.cli.console import answers

KEPT = Path("out/bench")


@dataclass(frozen=True)
class Contender:
    """A function to time; `run` processes `count` samples."""

    count: int
    run: Callable[[], object]


@dataclass(frozen=True)
class Times:
    """Seconds per sample of each turn, in order."""

    seconds: tuple[float, ...]

    @property
    def nanoseconds(self) -> float:
        """Median per sample [ns]."""
        return 1e9 * median(self.seconds)

    def over(self, other: Times) -> float:
        """Median over the turns of this time divided by the other one's in the same turn."""
        return median(mine / theirs for mine, theirs in zip(self.seconds, other.seconds, strict=True))


def take_turns(contenders: Mapping[str, Contender], turns: int) -> dict[str, Times]:
    """Times of each contender, after a first round that compiles, warms caches and is not counted."""
    taken: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(turns + 1):
        for name, contender in contenders.items():
            begin = thread_time()
            contender.run()
            if turn:
                taken[name].append((thread_time() - begin) / contender.count)
    return {name: Times(tuple(seconds)) for name, seconds in taken.items()}


def keep(name: str, content: object) -> None:
    """Write the results of a benchmark to its JSON file, and print the name of the file."""
    file = KEPT / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1), encoding="utf-8")
    answers.print(f"written: {file}")
