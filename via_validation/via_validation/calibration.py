"""Numbers of `via_gap.selection.reliability` from answers whose true cause is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, isfinite

from scipy.optimize import isotonic_regression
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.reliability import Counts, Reliability

NAMING = ("effect", "several_effects", "main_effect")
WITH_CAUSES = (*NAMING, "unknown", "cannot_tell")


@dataclass(frozen=True)
class Calibrated:
    """One answer, compared with the truth.

    left       see `via_gap.selection.reliability.decisive`; None: the answer has no causes
    truth      share of the true cause in the report (of several the smallest); None: no cause can be found
    distances  of the true parameters of named effects from the reported ones, over half the 95 % interval
    widened    factor by which an earlier calibration widened these intervals
    """

    verdict: str
    level: str
    left: float | None
    first_right: bool
    truth: float | None
    distances: tuple[float, ...] = ()
    widened: float = 1.0


def calibrated(answered: Sequence[Calibrated], origin: str, seeds: str) -> Reliability:
    """The numbers from answers whose true cause is known."""
    verdicts = {}
    for verdict in WITH_CAUSES:
        same = [each for each in answered if each.verdict == verdict]
        verdicts[verdict] = _groups([(each.left, each.first_right) for each in same if each.left is not None])
    shares: dict[str, list[float]] = {}
    for each in answered:
        if each.truth is not None and each.verdict in NAMING:
            shares.setdefault(each.level, []).append(each.truth)
    least = {level: _least(values) for level, values in shares.items()}
    cases = {level: len(values) for level, values in shares.items()}
    distances = {
        verdict: [
            each.widened * distance for each in answered if each.verdict == verdict for distance in each.distances
        ]
        for verdict in NAMING
    }
    return Reliability(
        origin=origin, seeds=seeds, verdicts=verdicts, least_share=least, cases=cases,
        wider={verdict: max(_holding(known), 1.0) for verdict, known in distances.items()},
        parameters={verdict: len(known) for verdict, known in distances.items()},
    )  # fmt: skip


def _groups(answers: Sequence[tuple[float, bool]]) -> list[Counts]:
    """Groups of answers (left, right), in which the share of right ones falls with what is left."""
    if not answers:
        return []
    ordered = sorted(answers, key=lambda each: each[0])
    ends = isotonic_regression([float(right) for _, right in ordered], increasing=False).blocks
    return [
        Counts(left=ordered[end - 1][0], answers=int(end - start), right=sum(right for _, right in ordered[start:end]))
        for start, end in pairwise(ends)
    ]


def _least(shares: Sequence[float]) -> float:
    """The share 1 - q; 0 if there are too few cases for the confidence level."""
    score = _quantile([1.0 - share for share in shares])
    return 0.0 if score is None else 1.0 - score


def _quantile(scores: Sequence[float]) -> float | None:
    """The ceil((n + 1) (1 - significance))-th smallest of n scores; None if there are too few."""
    rank = ceil((len(scores) + 1) * (1.0 - NUMBERS.significance))
    return None if rank > len(scores) else float(sorted(scores)[rank - 1])


def _holding(distances: Sequence[float]) -> float:
    """The factor by which intervals hold 95 % of parameters at these distances; 1 if there are too few.

    Parameters that the answer lacks, such as a further harmonic, are infinitely far: no width would hold them.
    """
    distances = [each for each in distances if isfinite(each)]
    rank = ceil(len(distances) * (1.0 - NUMBERS.significance))
    return 1.0 if len(distances) * NUMBERS.significance < 1.0 else sorted(distances)[rank - 1]
