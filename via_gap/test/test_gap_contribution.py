"""Which of several named effects is the main one: that without which the repair leaves most."""

from types import SimpleNamespace

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from gap_models import BACKLASH, COULOMB, PAYLOAD, VISCOUS, evaluated, scales
from via_gap.candidates.fit import Fit
from via_gap.diagnosis import diagnose
from via_gap.report.answer import _weights
from via_gap.report.causes import compared_causes, conformal_set
from via_gap.selection import gap, reliability
from via_gap.selection.comparison import ModelComparison
from via_gap.selection.contribution import confirmed
from via_gap.selection.verdict import Decision
from via_sim.effects import Effect


def test_the_main_effect_comes_first_with_what_the_repair_leaves_without_each():
    """A small dry friction as certain as a large payload: the payload is the main effect, and its site leads."""
    friction = Effect("coulomb_friction", "link", {"torque": 0.01})
    payload = Effect("payload", "link", {"mass": 0.3, "distance": 0.3})
    report = diagnose([log_of(rigid(), (friction, payload), seed=3, duration=12.0)], rigid())
    first, second = report.causes[:2]
    assert [first.effect, second.effect] == ["payload", "coulomb_friction"] == [each.effect for each in report.effects]
    assert first.left == second.left < second.without < 0.5 * first.without < 1.0
    assert all(each.without is None for each in report.causes[2:])


def test_parts_of_named_effects_follow_what_each_explains():
    """Root mean squares: 2 with both, 10 without the first, 4 without the second: gains 8 and 2, mean 5."""
    model = evaluated([4.0] * 8, COULOMB, BACKLASH)
    decision = Decision("several_effects", model, 1.0, without=(100.0, 16.0))
    assert [decision.part(place) for place in (COULOMB, BACKLASH, PAYLOAD)] == pytest.approx([1.6, 0.4, 1.0])
    alone = Decision("effect", evaluated([4.0] * 8, COULOMB), 1.0)
    assert alone.part(COULOMB) == 1.0


def test_a_refuted_decision_keeps_nothing_of_its_repair():
    model, tuned = evaluated([4.0] * 8, COULOMB, BACKLASH), evaluated([9.0] * 8)
    decision = Decision("main_effect", model, 0.9, without=(100.0, 16.0), transfer={"speed": 0.1})
    decision = decision.refuted(tuned, "no reason")
    assert (decision.verdict, decision.named, decision.equivalent) == ("cannot_tell", (), ())
    assert decision.without == () and decision.transfer == {} and decision.reason == "no reason"


def test_a_fit_in_another_order_keeps_each_effect_with_its_covariance():
    payload = Effect("payload", "link", {"mass": 0.3, "distance": 0.4})
    friction = Effect("coulomb_friction", "link", {"torque": 0.01})
    covariance, tolerances = np.arange(9.0).reshape(3, 3), np.arange(6.0).reshape(2, 3)
    fit = Fit((payload, friction), np.zeros(2), 1.0, np.empty(0), covariance, tolerances)
    other = fit.reordered([1, 0])
    assert other.effects == (friction, payload) and other.values == [0.01, 0.3, 0.4]
    assert other.covariance.tolist() == [[8.0, 6.0, 7.0], [2.0, 0.0, 1.0], [5.0, 3.0, 4.0]]
    assert other.tolerances.tolist() == [[2.0, 0.0, 1.0], [5.0, 3.0, 4.0]]
    assert other.reordered([1, 0]).covariance.tolist() == covariance.tolist()


def test_a_model_whose_final_fit_does_as_well_without_one_of_its_effects_is_withdrawn(monkeypatch):
    """The dry friction matters in the search, and no more after the final fit."""
    tuned = evaluated([200.0] * 8)
    pair, single = evaluated([4.0] * 8, PAYLOAD, COULOMB), evaluated([9.0] * 8, PAYLOAD)
    without = {PAYLOAD: evaluated([100.0] * 8, COULOMB), COULOMB: evaluated([4.1] * 8, PAYLOAD)}
    decision = Decision("several_effects", pair, 1.0)
    assert not confirmed(decision, list(without.values()), tuned)
    assert confirmed(decision, [without[PAYLOAD], single], tuned)
    assert confirmed(Decision("effect", single, 1.0), [], tuned)

    monkeypatch.setattr(Decision, "converged", lambda self, *_: self)
    monkeypatch.setattr(gap, "rivals", lambda *_: None)
    monkeypatch.setattr(gap, "Achievable", lambda _: SimpleNamespace(beside=None))
    monkeypatch.setattr(gap, "decide", lambda _tuned, models, *_: Decision("several_effects", models[0], 1.0))
    left = {pair: list(without.values()), single: []}
    monkeypatch.setattr(gap, "reduced", lambda decided, _: left[decided.chosen])
    monkeypatch.setattr(gap, "measured_gap", lambda _, chosen, __: SimpleNamespace(after=chosen.rms, tuned=tuned.rms))
    experiment = SimpleNamespace(tuned=tuned, fitted=None)
    comparison = ModelComparison(experiment, SimpleNamespace(scales=None), [pair, single])
    assert gap.decide_and_measure(comparison).decision.named == (PAYLOAD,)


def several(**changes) -> Decision:
    """Two named effects, the second with the larger share, and a rival of the first."""
    model, rival = evaluated([4.0] * 8, COULOMB, BACKLASH), evaluated([9.0] * 8, VISCOUS, BACKLASH)
    shares = ((BACKLASH, 1.0), (COULOMB, 0.7), (VISCOUS, 0.3))
    known = {"shares": shares, "models": (model, model, rival), "without": (100.0, 16.0), **changes}
    return Decision("main_effect", model, 0.9, **known)


def test_named_causes_come_in_the_order_of_the_repair_whatever_their_shares():
    tuned = evaluated([200.0] * 8)
    causes = compared_causes(flexible(), several(), scales(), tuned)
    assert [each.effect for each in causes] == ["coulomb_friction", "backlash", "viscous_friction"]
    assert [each.without for each in causes] == pytest.approx([0.5, 0.08, None])
    assert [each.share for each in causes] == [0.7, 1.0, 0.3]


def test_the_site_of_the_effect_that_explains_most_weighs_most():
    """The second effect is in every good model and explains a quarter of what the first one does."""
    weights = _weights(several(), ())
    assert weights == pytest.approx({("motor", 1): 0.7 * 1.6 + 0.3, ("transmission", 1): 1.0 * 0.4})


def test_what_a_main_effect_leaves_in_other_motion_decides_its_probability(monkeypatch):
    groups = [reliability.Counts(left=0.1, answers=9, right=9), reliability.Counts(left=1.0, answers=9, right=4)]
    counted = reliability.shipped().model_copy(update={"verdicts": {"main_effect": groups}})
    monkeypatch.setattr(reliability, "shipped", lambda: counted)
    for transfer, trust in (({}, 0.95), ({"time": 0.01, "speed": 0.5}, 0.45)):  # on held-out data, .02 is left
        causes = compared_causes(flexible(), several(transfer=transfer), scales(), evaluated([200.0] * 8))
        assert [each.probability for each in causes] == pytest.approx([trust * each.share for each in causes])


def test_a_conformal_set_belongs_to_answers_that_name_a_cause(monkeypatch):
    counted = reliability.shipped().model_copy(update={"least_share": {"full": 0.5, "link only": 0.0}})
    monkeypatch.setattr(reliability, "shipped", lambda: counted)
    causes = compared_causes(flexible(), several(), scales(), evaluated([200.0] * 8))
    assert conformal_set("main_effect", "full", causes) == tuple(each.place for each in causes[:2])
    assert conformal_set("cannot_tell", "full", causes) is None
    assert conformal_set("main_effect", "link only", causes) is None  # too few calibration cases
