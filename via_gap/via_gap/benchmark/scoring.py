"""All judged cases as the numbers of the specification, with the limit each has to keep."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from via_gap.benchmark.judging import Judged

BINS = 10
POINTS = 0.05  # by which predicted and measured shrinkage may differ


@dataclass(frozen=True)
class Number:
    """One number of the table. `limit` is None where none was set."""

    name: str
    value: float | None  # None: no case
    cases: int
    limit: float | None = None
    at_least: bool = True

    @property
    def kept(self) -> bool | None:
        if self.limit is None:
            return None
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Bin:
    """Answers whose probability lies in [low, low + 1/BINS): their mean probability and how many were right."""

    low: float
    count: int
    probability: float
    right: float


@dataclass(frozen=True)
class Score:
    judged: tuple[Judged, ...]
    numbers: tuple[Number, ...]
    reliability: tuple[Bin, ...]

    @property
    def missed(self) -> tuple[Judged, ...]:
        """Every case that was not answered right."""
        return tuple(each for each in self.judged if not each.right)


def score(judged: Sequence[Judged]) -> Score:
    single = [each for each in judged if each.kind == "single"]
    no_gap = [each for each in judged if each.kind == "no_gap"]
    unknown = [each for each in judged if each.kind == "unknown"]
    pairs = [each for each in judged if each.kind == "pair"]
    limited = [each for each in judged if each.kind == "limited"]
    answered = [each for each in judged if each.answered]
    shrunk = [each for each in judged if each.predicted is not None and each.measured is not None and each.answered]
    bins = reliability(answered)
    numbers = [
        _share("where right", single, lambda each: each.where_right, 0.95),
        _share("top-1", single, lambda each: each.top1, 0.90),
        _share("top-1 with its place", single, lambda each: each.place_right),
        _share("in set", single, lambda each: each.in_set, 0.97),
        _mean("mean set size", [max(len(each.tied), 1) for each in single if each.answered], 1.5, at_least=False),
        _share("false alarms on no gap", no_gap, _alarmed, 0.02, at_least=False),
        _share("no gap recognised", no_gap, lambda each: each.verdict == "no_gap"),
        _share("unknown recognised", unknown, lambda each: each.verdict == "unknown", 0.90),
        _share("two effects: both named", pairs, lambda each: each.both, 0.80),
        _share("two effects: both named or in the set", pairs, lambda each: each.in_set),
        _share("two effects: one of them first", pairs, _one_of_two),
        *(
            _share(f"{level}: {name}", [each for each in limited if each.level == level], what)
            for level in sorted({each.level for each in limited})
            for name, what in (
                ("top-1", lambda each: each.top1),
                ("in set", lambda each: each.in_set),
                ("cannot tell", lambda each: each.verdict == "cannot_tell"),
            )
        ),
        _mean("closes, of what can be closed", [each.closes for each in single], 0.90),
        _mean("closes on the withheld log", [each.measured_closes for each in single]),
        _mean("predicted less measured shrinkage, absolute", [_off(each) for each in shrunk], POINTS, at_least=False),
        _share("predicted within 5 points of measured", shrunk, lambda each: _off(each) <= POINTS),
        Number("expected calibration error", calibration_error(bins), len(answered), 0.05, at_least=False),
        _mean("Brier score", [_brier(each) for each in answered]),
        _share("abstained (cannot tell)", judged, lambda each: each.verdict == "cannot_tell"),
        _share("without a report", judged, lambda each: not each.verdict),
        _mean("seconds per case", [each.seconds for each in judged]),
    ]  # fmt: skip
    return Score(tuple(judged), tuple(numbers), bins)


def reliability(answered: Sequence[Judged]) -> tuple[Bin, ...]:
    """Bins that hold an answer. An answer to a case without a gap or with foreign physics is a wrong one."""
    made = []
    told = np.array([each.probability for each in answered], dtype=np.float64)
    right = np.array([_first_right(each) for each in answered], dtype=np.float64)
    which = np.minimum((told * BINS).astype(int), BINS - 1)
    for k in range(BINS):
        here = which == k
        if here.any():
            made.append(Bin(k / BINS, int(here.sum()), float(told[here].mean()), float(right[here].mean())))
    return tuple(made)


def calibration_error(bins: Sequence[Bin]) -> float | None:
    """Mean distance of probability and share of right answers, each bin weighing as many answers as it holds."""
    count = sum(each.count for each in bins)
    if not count:
        return None
    return sum(each.count * abs(each.probability - each.right) for each in bins) / count


def _first_right(each: Judged) -> bool:
    """Whether the first cause named is one of those that are there."""
    return each.named[0].effect in {truth.effect for truth in each.truths}


def _alarmed(each: Judged) -> bool:
    return each.verdict in ("effect", "two_effects", "unknown")


def _one_of_two(each: Judged) -> bool:
    return each.answered and _first_right(each)


def _brier(each: Judged) -> float:
    return ((each.probability or 0.0) - _first_right(each)) ** 2


def _off(each: Judged) -> float:
    return abs((each.predicted or 0.0) - (each.measured or 0.0))


def _share(
    name: str, cases: Sequence[Judged], what: Callable[[Judged], bool | None], limit: float | None = None,
    at_least: bool = True,
) -> Number:  # fmt: skip
    return _mean(name, [float(bool(what(each))) for each in cases], limit, at_least)


def _mean(
    name: str,
    values: Iterable[float | None],
    limit: float | None = None,
    at_least: bool = True,
) -> Number:
    numbers = [value for value in values if value is not None]
    mean = float(np.mean(numbers)) if numbers else None
    return Number(name, mean, len(numbers), limit, at_least)
