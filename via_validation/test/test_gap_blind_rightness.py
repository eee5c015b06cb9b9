"""Right answers: equivalent names, ties, confidently wrong answers, conformal sets, intervals."""

from __future__ import annotations

from typing import Any

import pytest
from gap_verdicts import COULOMB, LAG, key, report
from via_validation.sealed.evaluation import evaluate
from via_validation.sealed.intervals import intervals_hold
from via_validation.sealed.rightness import Cause, covered, explanations, locates, names, same_site


def cause(effect: str, site: str, motor: int = 0) -> Cause:
    return Cause(effect, site, motor)


def test_an_effect_on_both_motors_is_one_cause_or_one_at_each_motor() -> None:
    both = cause("viscous_friction", "motor", 0)
    one, two = cause("viscous_friction", "motor", 1), cause("viscous_friction", "motor", 2)
    assert explanations(both, "polynomial_pair") == ((both,), (one, two))
    assert locates([both], both, "polynomial_pair") and locates([one, two], both, "polynomial_pair")
    assert not locates([one], both, "polynomial_pair") and names(one, both, "polynomial_pair")  # half of it
    assert not locates([both], one, "polynomial_pair")  # names a motor without the effect
    assert locates(
        [cause("torque_ripple", "motor", 0)], cause("torque_ripple", "motor", 1), "position_drive"
    )  # the only one
    assert same_site(("motor", 2), both, "polynomial_pair") and not same_site(("link", 0), both, "polynomial_pair")


def test_the_same_physics_under_another_name_is_right() -> None:
    offset, preset = cause("encoder_offset", "sensor", 1), cause("preset_error", "transmission", 1)
    for truth, named in ((offset, preset), (preset, offset)):
        assert names(named, truth, "exponential_pair") and locates([named], truth, "exponential_pair")
        assert not names(named, truth, "series_elastic")
    assert not names(cause("preset_error", "transmission", 2), offset, "exponential_pair")
    assert not names(preset, cause("encoder_offset", "sensor", 0), "exponential_pair")
    payload, inertia, gravity = cause("payload", "link"), cause("link_inertia", "link"), cause("gravity_error", "link")
    assert names(inertia, payload, "stiff", [gravity]) and covered([payload], [gravity, inertia], "stiff")
    assert not names(inertia, payload, "stiff") and not covered([payload], [inertia], "stiff")
    assert not covered([payload], [payload, gravity], "stiff") or names(gravity, payload, "stiff", [payload])
    assert names(gravity, cause("encoder_offset", "sensor", 0), "rigid")
    assert not names(gravity, cause("encoder_offset", "sensor", 0), "stiff")  # there the spring sees the offset too
    assert same_site(("link", 0), cause("torque_ripple", "motor", 1), "rigid")
    assert not same_site(("link", 0), cause("torque_ripple", "motor", 1), "stiff")


def test_friction_models_that_a_log_cannot_separate_are_different_causes() -> None:
    stribeck = {"effect": "stribeck_friction", "site": "motor", "motor": 1}
    answer = report("effect", (COULOMB, 0.6), equivalence_set=[COULOMB, stribeck])
    found = evaluate("a", key("single", stribeck), answer, None, None)
    assert not found.top1 and found.in_set and found.tied_right
    many = [COULOMB, stribeck, LAG, {**COULOMB, "motor": 2}]
    found = evaluate("a", key("single", stribeck), {**answer, "equivalence_set": many}, None, None)
    assert found.in_set and not found.tied_right  # a set of four separates nothing


def test_a_wrong_first_cause_of_probability_one_half_is_confidently_wrong() -> None:
    for kind, effects in (("single", [COULOMB]), ("no_gap", []), ("unknown", [{**LAG, "effect": "sagging_supply"}])):
        for probability, wrong in ((0.5, True), (0.49, False)):
            found = evaluate("a", key(kind, *effects), report("effect", (LAG, probability)), None, None)
            assert found.confidently_wrong is wrong
    assert not evaluate("a", key("single", LAG), report("effect", (LAG, 0.9)), None, None).confidently_wrong
    unnamed = evaluate("a", key("single", COULOMB), report("unknown", (LAG, 0.9)), None, None)
    assert not unnamed.confidently_wrong


def test_the_conformal_set_is_evaluated_independently_of_the_verdict() -> None:
    answer = report("cannot_tell", (LAG, 0.3), conformal_set=[LAG, COULOMB])
    assert evaluate("a", key("single", COULOMB), answer, None, None).in_conformal is True
    assert evaluate("a", key("pair", COULOMB, {**LAG, "effect": "payload"}), answer, None, None).in_conformal is False
    assert evaluate("a", key("single", COULOMB), report("effect", (LAG, 0.3)), None, None).in_conformal is None
    assert evaluate("a", key("no_gap"), answer, None, None).in_conformal is None


def stated(effect: dict[str, Any], **values: tuple[float, float]) -> dict[str, Any]:
    return {**effect, "parameters": {name: {"value": v, "sd": sd, "unit": ""} for name, (v, sd) in values.items()}}


def test_intervals_hold_within_two_standard_deviations() -> None:
    truth = {**COULOMB, "parameters": {"torque": 0.03}}
    named = Cause(**COULOMB)

    def holds(*causes: dict[str, Any]) -> list[bool]:
        return [each.holds for each in intervals_hold([truth], causes, [named], "stiff")]

    assert holds(stated(COULOMB, torque=(0.031, 0.0006))) == [True]
    assert holds(stated(COULOMB, torque=(0.031, 0.0005))) == [False]
    given = stated(COULOMB, torque=(0.031, 0.0005))
    given["parameters"]["torque"]["interval"] = [0.0299, 0.032]
    assert holds(given) == [True]
    assert holds(stated({**COULOMB, "motor": 2}, torque=(0.03, 0.1))) == []  # not its place: nothing to compare


@pytest.mark.parametrize(("effect", "site"), [("torque_ripple", "motor"), ("gear_error", "transmission")])
def test_terms_of_a_series_are_compared_by_their_order(effect: str, site: str) -> None:
    series = {"effect": effect, "site": site, "motor": 1}
    true = {"amplitude": 0.1, "order": 12.0, "phase": 0.5, "amplitude_2": 0.05, "order_2": 28.0, "phase_2": 3.0}

    def holds(**values: tuple[float, float]) -> list[bool]:
        cause = stated(series, **values)
        return [e.holds for e in intervals_hold([{**series, "parameters": true}], [cause], [Cause(**series)], "stiff")]

    turned = {  # in another order, a turn away, one with its sign and half a period
        "amplitude": (0.0505, 0.001), "order": (28.0, 0.01), "phase": (3.01 - 2.0 * 3.14159265, 0.02),
        "amplitude_2": (-0.1, 0.001), "order_2": (12.0, 0.01), "phase_2": (0.5 + 3.14159265, 0.02),
    }  # fmt: skip
    assert holds(**turned) == [True] * 4
    one = {"amplitude": (0.1, 0.001), "order": (12.0, 0.01), "phase": (0.6, 0.02)}
    assert holds(**one) == [False, True, False]  # a wrong phase, and a term that is missing
