"""How likely an answer is to be right: learned from simulated cases, from three things that its report tells.

    logit p = steady + margin m - left s - pair k

m is by how much the best cause beats the next one that it is not tied with [mean log squared error, at most 1], 0 where
another is tied with it; s what it leaves beyond the sensors' noise [the same, at most 3]; k 1 for two effects, else 0.
The four numbers are fitted by penalised maximum likelihood to the answers given to cases whose keys are known:
J. Platt, Probabilistic outputs for support vector machines (1999), with more than one score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict
from scipy.optimize import minimize
from via_core.signals import Array

from via_gap.report.report import GapReport
from via_gap.selection.evidence import NOISE

MOST_MARGIN, MOST_LEFT = 1.0, 3.0
PRIOR = (2.0, 1.0, 1.0, 0.5)  # where the fit begins
STIFF = 0.5  # of the pull towards it: a handful of cases moves no number far


class Numbers(BaseModel):
    """The fit, and what it was fitted to."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    steady: float
    margin: float
    left: float
    pair: float
    answers: int
    right: int
    seeds: str
    origin: str


@dataclass(frozen=True)
class Answer:
    """What speaks for the first cause of a report that named one."""

    margin: float
    left: float
    pair: bool

    @property
    def row(self) -> Array:
        return np.array([1.0, self.margin, -self.left, -float(self.pair)])


def answer_of(report: GapReport) -> Answer | None:
    """None where the report names no cause, or where the readings alone showed it."""
    if report.verdict not in ("effect", "two_effects") or not report.causes:
        return None
    first = report.causes[0]
    if any(each.equation == "readings" and each.site == first.site for each in report.where):
        return None
    pair = report.verdict == "two_effects"
    tied = len(report.equivalence_set) > len(report.effects)
    others = [each.score for each in report.causes[1:] if each.effect != first.effect]
    margin = MOST_MARGIN if pair or not others else float(np.clip(min(others) - first.score, 0.0, MOST_MARGIN))
    left = float(np.clip(first.score - NOISE, 0.0, MOST_LEFT))
    return Answer(0.0 if tied else margin, left, pair)


def probability(answer: Answer, numbers: Numbers) -> float:
    weights = np.array([numbers.steady, numbers.margin, numbers.left, numbers.pair])
    return float(1.0 / (1.0 + np.exp(-answer.row @ weights)))


def fit_numbers(answers: Sequence[Answer], right: Sequence[bool], seeds: str, origin: str) -> Numbers:
    """The numbers under which what was right and wrong is likeliest; none but `steady` ever speaks the wrong way."""
    rows, signs = np.array([each.row for each in answers]), np.where(np.asarray(right), 1.0, -1.0)

    def loss(weights: Array) -> float:
        fitted = float(np.sum(np.logaddexp(0.0, -signs * (rows @ weights))))
        return fitted + 0.5 * STIFF * float(np.sum((weights - PRIOR) ** 2))

    best = minimize(loss, np.array(PRIOR), bounds=[(None, None), (0.0, None), (0.0, None), (0.0, None)]).x
    steady, margin, left, pair = (round(float(each), 4) for each in best)
    return Numbers(
        steady=steady, margin=margin, left=left, pair=pair, answers=len(signs), right=int(np.sum(signs > 0.0)),
        seeds=seeds, origin=origin,
    )  # fmt: skip


def with_probabilities(report: GapReport, numbers: Numbers) -> GapReport:
    """The report with the learned probability of its first cause; the others share what is left as they did."""
    answer = answer_of(report)
    if answer is None:
        return report
    told = probability(answer, numbers)
    named = {(place.effect, place.site, place.motor) for place in report.effects}
    rest = sum(c.probability for c in report.causes if (c.effect, c.site, c.motor) not in named)
    causes = []
    for cause in report.causes:
        if (cause.effect, cause.site, cause.motor) in named:
            causes.append(cause.model_copy(update={"probability": told}))
        else:
            share = cause.probability / rest if rest > 0.0 else 0.0
            causes.append(cause.model_copy(update={"probability": (1.0 - told) * share}))
    return report.model_copy(update={"causes": tuple(causes)})


@cache
def shipped_numbers() -> Numbers:
    """What `via gap blind calibrate` wrote."""
    text = resources.files("via_gap.report").joinpath("probability.yaml").read_text(encoding="utf-8")
    return Numbers.model_validate(yaml.safe_load(text))
