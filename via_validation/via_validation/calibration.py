"""Numbers of `via_gap.selection.reliability` from answers whose true cause is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from via_gap.selection.numbers import NUMBERS
from via_gap.selection.reliability import Counts, Reliability

WITH_CAUSES = ("effect", "several_effects", "main_effect", "unknown", "cannot_tell")


@dataclass(frozen=True)
class Calibrated:
    """One answer, compared with the truth.

    truth      share of the true cause in the report (of several the smallest); None: no cause can be found
    distances  of the true parameters of named effects from the reported ones, over half the 95 % interval
    """

    verdict: str
    level: str
    has_causes: bool
    first_right: bool
    truth: float | None
    distances: tuple[float, ...] = ()


def calibrated(answered: Sequence[Calibrated], origin: str, seeds: str, wider: float = 1.0) -> Reliability:
    """The numbers from answers whose true cause is known; `wider`: the factor that their intervals contain."""
    verdicts = {}
    for verdict in WITH_CAUSES:
        answers = [each for each in answered if each.verdict == verdict and each.has_causes]
        verdicts[verdict] = Counts(answers=len(answers), right=sum(each.first_right for each in answers))
    shares: dict[str, list[float]] = {}
    for each in answered:
        if each.truth is not None:
            shares.setdefault(each.level, []).append(each.truth)
    least = {level: _least(values) for level, values in shares.items()}
    cases = {level: len(values) for level, values in shares.items()}
    distances = [distance for each in answered for distance in each.distances]
    wider *= _holding(distances)
    return Reliability(
        origin=origin, seeds=seeds, verdicts=verdicts, least_share=least, cases=cases, wider=max(wider, 1.0),
        parameters=len(distances),
    )  # fmt: skip


def _least(shares: Sequence[float]) -> float:
    """The share 1 - q; 0 if there are too few cases for the confidence level."""
    score = _quantile([1.0 - share for share in shares])
    return 0.0 if score is None else 1.0 - score


def _quantile(scores: Sequence[float]) -> float | None:
    """The ceil((n + 1) (1 - significance))-th smallest of n scores; None if there are too few."""
    rank = ceil((len(scores) + 1) * (1.0 - NUMBERS.significance))
    return None if rank > len(scores) else float(sorted(scores)[rank - 1])


def _holding(distances: Sequence[float]) -> float:
    """The factor by which intervals hold 95 % of parameters at these distances; 1 if there are too few."""
    rank = ceil(len(distances) * (1.0 - NUMBERS.significance))
    return 1.0 if len(distances) * NUMBERS.significance < 1.0 else sorted(distances)[rank - 1]
