"""Scores of all cases, overall and by signal set, clean or dirty, each with its limit.

The limits are the project's targets for a sealed run on fresh seeds. Limits on naming apply to recordings of good
quality, limits on false alarms and confidently wrong answers to all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from via_validation.sealed.evaluation import Evaluation
from via_validation.sealed.recording import LEVELS

BINS = 10
FILLED = 5  # fewest non-empty bins for a meaningful calibration error
POINTS = 0.03  # largest difference of predicted and measured decrease of the gap
OVERALL = "all"


@dataclass(frozen=True)
class Number:
    """One number of the table; `limit` None: no limit. A number without a case misses its limit."""

    name: str
    value: float | None  # None: no case
    cases: int
    limit: float | None = None
    at_least: bool = True
    group: str = OVERALL  # of cases

    @property
    def kept(self) -> bool | None:
        if self.limit is None:
            return None
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Bin:
    """Answers with a probability in [low, low + 1/BINS): their number, mean probability and share right."""

    low: float
    count: int
    probability: float
    right: float


@dataclass(frozen=True)
class Score:
    evaluations: tuple[Evaluation, ...]
    numbers: tuple[Number, ...]  # overall, then by group
    reliability: tuple[Bin, ...]

    @property
    def missed(self) -> tuple[Evaluation, ...]:
        """Every case with a wrong answer."""
        return tuple(each for each in self.evaluations if not each.right)


def score(evaluations: Sequence[Evaluation]) -> Score:
    """All numbers: overall, by signal set, by clean and dirty cases of each, and for degraded recordings."""
    answered = [each for each in evaluations if each.answered]
    bins = reliability(answered)
    good = [each for each in evaluations if each.quality == "good"]
    named = [each for each in good if each.level != LEVELS[-1]]
    numbers = [
        *_naming([each for each in named if not each.dirty], limits=True),
        _share("main cause named, with dirt", _with_truth([each for each in named if each.dirty]), _main, 0.90),
        _share("unknown recognised", _kind(named, "unknown"), lambda each: each.verdict == "unknown", 0.90),
        *_alarms(evaluations),
        *_explaining(good),
        Number("expected calibration error", calibration_error(bins), len(answered), 0.05, at_least=False),
        Number("bins that hold answers", float(len(bins)), len(answered), FILLED),
        _mean("Brier score", [_brier(each) for each in answered]),
        *_coverage(good),
        _share("abstained (cannot_tell)", evaluations, lambda each: each.verdict == "cannot_tell"),
        _share("without a report", evaluations, lambda each: not each.verdict),
        _mean("seconds per case", [each.seconds for each in evaluations]),
    ]
    for level in LEVELS:
        of_level = [each for each in evaluations if each.level == level]
        numbers += _set_numbers(of_level, level) if of_level else []
        for dirty in (False, True):
            here = [each for each in of_level if each.dirty == dirty and each.quality == "good"]
            numbers += _group_numbers(here, f"{level.replace('_', ' ')}, {'dirty' if dirty else 'clean'}")
    degraded = [each for each in evaluations if each.quality != "good"]
    numbers += _group_numbers(degraded, "degraded recordings")
    return Score(tuple(evaluations), tuple(numbers), bins)


def _naming(cases: Sequence[Evaluation], limits: bool) -> list[Number]:
    """Right sites and causes; `limits`: whether the limits of the three richer signal sets apply."""
    single, pairs = _kind(cases, "single"), _kind(cases, "pair")
    where, first, both = (0.95, 0.92, 0.85) if limits else (None, None, None)
    return [
        _share("where right", single, lambda each: each.where_right, where),
        _share("top-1", single, lambda each: each.top1, first),
        _share("top-1 with its place", single, lambda each: each.place_right),
        _share("named or rightly tied", single, lambda each: each.tied_right),
        _share("in set", single, lambda each: each.in_set),
        _mean("mean set size", [max(len(each.tied), 1) for each in single if each.answered]),
        _share("two effects: both named", pairs, lambda each: each.both, both),
        _share("two effects: both named or in the set", pairs, lambda each: each.in_set),
        _share("two effects: one of them first", pairs, _main),
    ]


def _alarms(cases: Sequence[Evaluation]) -> list[Number]:
    """False alarms and confidently wrong answers."""
    no_gap = _kind(cases, "no_gap")
    return [
        _share("false alarms on no gap", no_gap, lambda each: each.alarmed, 0.02, at_least=False),
        _share("no gap recognised", no_gap, lambda each: each.verdict == "no_gap"),
        _share("confidently wrong", cases, lambda each: each.confidently_wrong, 0.01, at_least=False),
    ]


def _explaining(cases: Sequence[Evaluation], limits: bool = True) -> list[Number]:
    """Fraction of the gap explained by the answer, and accuracy of the predicted decrease."""
    single = _kind(cases, "single")
    shrunk = [each for each in cases if each.predicted is not None and each.measured is not None and each.answered]
    return [
        _mean("explained, of what is achievable", [each.explained for each in single], 0.95 if limits else None),
        _mean("explained on the withheld log", [each.measured_explained for each in single]),
        _mean(
            "predicted less measured shrinkage, absolute", [_off(each) for each in shrunk],
            POINTS if limits else None, at_least=False,
        ),
        _share("predicted within 3 points of measured", shrunk, lambda each: _off(each) <= POINTS),
    ]  # fmt: skip


def _coverage(cases: Sequence[Evaluation], limits: bool = True) -> list[Number]:
    """Share of 95 % intervals that contain the true parameter, with a lower and an upper limit."""
    holds = [each.holds for case in cases for each in case.inside]
    both = ((0.90, True), (0.98, False)) if limits else ((None, True),)
    return [_mean("parameter intervals hold the truth", map(float, holds), limit, at_least) for limit, at_least in both]


def _set_numbers(cases: Sequence[Evaluation], level: str) -> list[Number]:
    """Numbers with a limit per signal set, over clean and dirty cases."""
    last, good = level == LEVELS[-1], [each for each in cases if each.quality == "good"]
    sets = [each for each in good if each.conformal is not None]
    found = [
        _share("false alarms on no gap", _kind(cases, "no_gap"), lambda each: each.alarmed, 0.02, at_least=False),
        _share("conformal set holds the truth", [e for e in sets if e.in_conformal is not None], _covers, 0.95),
        _mean(
            "mean size of the conformal set", [len(each.conformal or ()) for each in sets],
            1.5 if level == LEVELS[0] else None, at_least=False,
        ),
    ]  # fmt: skip
    if last:
        found.append(_share("named or rightly tied", _kind(good, "single"), lambda each: each.tied_right, 0.80))
    return [replace(each, group=level.replace("_", " ")) for each in found]


def _group_numbers(cases: Sequence[Evaluation], group: str) -> list[Number]:
    """All numbers of a group that have a case, without limits."""
    found = [
        *_naming(cases, limits=False),
        _share("main cause named", _with_truth(cases), _main),
        _share("unknown recognised", _kind(cases, "unknown"), lambda each: each.verdict == "unknown"),
        *(replace(each, limit=None) for each in _alarms(cases)),
        *_explaining(cases, limits=False),
        _calibration(cases),
        *_coverage(cases, limits=False),
        _share("abstained (cannot_tell)", cases, lambda each: each.verdict == "cannot_tell"),
    ]
    return [replace(each, group=group) for each in found if each.cases]


def parameter_coverage(evaluations: Sequence[Evaluation]) -> tuple[tuple[str, int, float], ...]:
    """(effect and parameter, number of intervals, share that contains the truth) of every parameter."""
    found: dict[str, list[bool]] = {}
    for case in evaluations:
        for each in case.inside:
            found.setdefault(f"{each.effect}: {each.parameter}", []).append(each.holds)
    return tuple((name, len(holds), sum(holds) / len(holds)) for name, holds in sorted(found.items()))


def reliability(answered: Sequence[Evaluation]) -> tuple[Bin, ...]:
    """Non-empty bins. A cause named for a joint without a gap, or for an unmodelled effect, is wrong."""
    made = []
    stated = np.array([each.probability for each in answered], dtype=np.float64)
    right = np.array([each.first_right for each in answered], dtype=np.float64)
    which = np.minimum((stated * BINS).astype(int), BINS - 1)
    for k in range(BINS):
        here = which == k
        if here.any():
            made.append(Bin(k / BINS, int(here.sum()), float(stated[here].mean()), float(right[here].mean())))
    return tuple(made)


def calibration_error(bins: Sequence[Bin]) -> float | None:
    """Mean |probability - share right| of the bins, weighted by their number of answers; None without an answer."""
    count = sum(each.count for each in bins)
    if not count:
        return None
    return sum(each.count * abs(each.probability - each.right) for each in bins) / count


def _calibration(cases: Sequence[Evaluation]) -> Number:
    answered = [each for each in cases if each.answered]
    return Number("expected calibration error", calibration_error(reliability(answered)), len(answered))


def _kind(cases: Sequence[Evaluation], kind: str) -> list[Evaluation]:
    return [each for each in cases if each.kind == kind]


def _with_truth(cases: Sequence[Evaluation]) -> list[Evaluation]:
    return [each for each in cases if each.kind in ("single", "pair")]


def _main(each: Evaluation) -> bool:
    return each.main_right


def _covers(each: Evaluation) -> bool | None:
    return each.in_conformal


def _brier(each: Evaluation) -> float:
    return ((each.probability or 0.0) - each.first_right) ** 2


def _off(each: Evaluation) -> float:
    return abs((each.predicted or 0.0) - (each.measured or 0.0))


def _share(
    name: str, cases: Sequence[Evaluation], what: Callable[[Evaluation], bool | None], limit: float | None = None,
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
