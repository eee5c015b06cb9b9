"""Probabilities: a planted relation comes back, evidence speaks the right way, and what is told adds up."""

import numpy as np
import pytest
from via_gap.report.probability import (
    Answer,
    Numbers,
    answer_of,
    fit_numbers,
    probability,
    shipped_numbers,
    with_probabilities,
)
from via_gap.report.report import Cause, GapReport, Place

TRUE = Numbers(steady=0.5, margin=3.0, left=1.5, pair=1.0, answers=1, right=1, seeds="-", origin="-")


def cause(effect: str, score: float, told: float) -> Cause:
    return Cause(effect=effect, site="link", joint="joint", probability=told, parameters={}, left=0.1, score=score)


def report(*causes: Cause, tied: int = 1) -> GapReport:
    places = [Place(effect=c.effect, site=c.site, joint=c.joint) for c in causes]
    return GapReport.model_validate(
        {
            "joint": "joint", "level": "full", "logs": ("a",), "holdout": ("b",), "verdict": "effect", "where": (),
            "causes": causes, "equivalence_set": places[:tied], "effects": places[:1], "gap": None, "nuisance": (),
            "data_check": (), "not_judged": (), "figures": None,
        }
    )  # fmt: skip


def test_a_planted_relation_is_learned() -> None:
    rng = np.random.default_rng(8)
    given = [Answer(rng.uniform(0, 1), rng.exponential(0.5), bool(rng.uniform() < 0.3)) for _ in range(6000)]
    right = [bool(rng.uniform() < probability(each, TRUE)) for each in given]
    found = fit_numbers(given, right, "1 to 6000", "test")
    told = np.array([probability(each, found) for each in given])
    assert np.abs(told - [probability(each, TRUE) for each in given]).mean() < 0.02
    assert (found.answers, found.right) == (6000, sum(right))


def test_a_handful_of_answers_never_turns_the_evidence_round() -> None:
    found = fit_numbers([Answer(1.0, 0.0, False), Answer(0.0, 2.0, True)], [False, True], "1", "test")
    assert min(found.margin, found.left, found.pair) >= 0.0


def test_more_margin_and_less_left_is_likelier_with_what_ships() -> None:
    numbers = shipped_numbers()
    best = probability(Answer(1.0, 0.0, False), numbers)
    assert best > 0.8
    for worse in (Answer(0.0, 0.0, False), Answer(1.0, 2.0, False), Answer(1.0, 0.0, True)):
        assert probability(worse, numbers) <= best


def test_probabilities_add_up_and_a_tie_is_no_margin() -> None:
    clear = report(cause("payload", 0.7, 0.9), cause("contact", 1.6, 0.1))
    assert answer_of(clear) == Answer(pytest.approx(0.9), pytest.approx(0.0069, abs=1e-3), False)
    told = with_probabilities(clear, TRUE)
    assert sum(each.probability for each in told.causes) == pytest.approx(1.0)
    assert told.causes[0].probability == pytest.approx(probability(Answer(0.9, 0.0069, False), TRUE), abs=1e-3)
    tied = report(cause("payload", 0.7, 0.5), cause("contact", 0.71, 0.5), tied=2)
    assert answer_of(tied).margin == 0.0
    assert answer_of(clear.model_copy(update={"verdict": "unknown"})) is None
