"""One decision: whatever the evidence, what it says about itself agrees; and plain cases are answered plainly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise, product

import numpy as np
import pytest
from gap_models import BACKLASH, COULOMB, DAMPING, DRAG, INERTIA, PAYLOAD, PLACES, STRIBECK, VISCOUS, evaluated
from hypothesis import given, settings
from hypothesis import strategies as st
from via_gap.candidates.fit import event_times
from via_gap.candidates.location import Location
from via_gap.residual.nuisance import BOUND
from via_gap.selection.evidence import Evaluation, compared, significantly_worse, simplest, without_needless
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.ties import (
    SAME,
    _agreeing,
    common_part,
    doubt,
    plainest,
    shares_of,
    tied_with,
)
from via_gap.selection.verdict import (
    Decision,
    _ranking,
    accepted,
    decide,
    fractions,
    improvable,
    ladder,
    no_gap,
    noise_only,
    relevant,
)

SEGMENTS = 40
NAMING = ("effect", "several_effects", "main_effect")
NEAR = (0.0, 0.01, 0.02, 0.04, 0.05, 0.07, 0.1, 0.3)  # of logarithms: around the margin, and far beyond it


@st.composite
def evidence(draw: st.DrawFn) -> tuple[Evaluation, list[Evaluation], float]:
    """What the device's own numbers, single effects and sets of them leave of segments, and a flexible model of all.

    Many models are as good as one another up to about the margin.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    most = draw(st.floats(0.0, 9.0))  # log of the squared error that the device's own numbers leave
    noise = draw(st.sampled_from([0.0, 0.02, 0.3, 1.0]))  # of the logarithms, from segment to segment
    whole = draw(st.booleans())
    shared = 0.5 * rng.normal(size=SEGMENTS)  # what a segment is like, whatever the model
    reached = [most * draw(st.floats(0.0, 1.0)) for _ in range(3)]  # by one effect, by two, by three

    def leaving(height: float, *locations: Location) -> Evaluation:
        height += 1e-6 * rng.uniform()  # no two are exactly alike: which of such is taken does not matter
        left = np.exp(height + noise * rng.normal(size=SEGMENTS) + shared)
        return evaluated(left, *locations, whole=whole)

    places = draw(st.lists(st.sampled_from(PLACES), unique=True, max_size=6))
    models = []
    for size in (1, 2, 3):
        sets = list(combinations(places, size))
        most_sets = st.lists(st.sampled_from(sets), unique=True, min_size=min(len(sets), 2), max_size=6)
        chosen = draw(most_sets) if sets else []
        models += [leaving(reached[size - 1] + draw(st.sampled_from(NEAR)), *each) for each in chosen]
    tuned = at_bound(leaving(most)) if draw(st.booleans()) else leaving(most)
    return tuned, models, float(np.exp(0.5 * most * draw(st.floats(0.0, 1.0))))


def at_bound(each: Evaluation) -> Evaluation:
    """The same with a device parameter at the end of its range."""
    return replace(each, fit=replace(each.fit, offsets=np.array([0.4, -BOUND])))


def decided(case: tuple[Evaluation, list[Evaluation], float]) -> Decision:
    tuned, models, bound = case
    return decide(tuned, models, reaching(bound))


def reaching(rms: float) -> Callable[[Evaluation], Evaluation]:
    """A flexible model that leaves as much, whatever it stands beside."""
    return lambda each: replace(each, segments=np.full(SEGMENTS, rms**2))


def parts_by_hand(tuned: Evaluation, model: Evaluation, flexible: Evaluation | None) -> tuple[float, ...]:
    """`fractions` as docs/method.md states it, one number after the other; None: the bound is the noise."""

    def root(each: Evaluation) -> float:
        return max(float(np.mean(each.segments)) ** 0.5, 1.0)

    def typical(each: Evaluation) -> float:
        return (
            root(each) if each.whole else max((float(np.exp(np.mean(np.log(1.0 + each.segments)))) - 1.0) ** 0.5, 1.0)
        )

    found = []
    for error in (root, typical):
        before, after = error(tuned), error(model)
        if before == 1.0:
            continue
        bound = 1.0 if flexible is None else min(error(flexible), after)
        found.append(1.0 if before <= bound else min((before - after) / (before - bound), 1.0))
    return tuple(found) or (1.0,)


def answer(tuned: Evaluation, models: list[Evaluation]) -> tuple[list[Evaluation], Evaluation]:
    """The models tied with the last step of the ladder, and its plainest name."""
    last = ladder(tuned, models)[-1]
    if last is tuned:
        return [], tuned
    same_size = [each for each in models if len(each.fit.effects) == len(last.fit.effects)]
    tied = tied_with(last, compared(same_size))
    return tied, plainest(tied)


def by_the_table(tuned: Evaluation, models: list[Evaluation], flexible: Evaluation) -> tuple[str, Evaluation]:
    """Verdict and model named, as the table in section 10 of docs/method.md lists them row by row."""
    noise = np.mean(tuned.segments) <= 2.0
    if noise and np.all(np.abs(tuned.fit.offsets) < 1.3):
        return "no_gap", tuned
    tied, last = answer(tuned, models)
    if last is tuned and noise:
        return "no_gap", tuned
    if last is tuned:
        return ("unknown" if accepted(flexible, tuned, tuned) else "cannot_tell"), tuned
    explained, share = parts_by_hand(tuned, last, flexible), parts_by_hand(tuned, last, None)
    if max(explained) < 0.8:
        return "unknown", tuned
    if max(share) < 0.25:
        return "cannot_tell", tuned
    if round(doubt(tied), 6) > 3.0:
        common = common_part(tied, models)
        if common is None or max(parts_by_hand(tuned, common, flexible)) < 0.8:
            return "cannot_tell", tuned
        if max(parts_by_hand(tuned, common, None)) < 0.25:
            return "cannot_tell", tuned
        return "main_effect", common
    if min(*explained, *share) < 0.95:
        return "main_effect", last
    return ("effect" if len(last.fit.effects) == 1 else "several_effects"), last


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_every_verdict_is_the_one_of_the_table(case):
    tuned, models, bound = case
    decision = decided(case)
    verdict, chosen = by_the_table(tuned, models, reaching(bound)(tuned))
    assert decision.verdict == verdict
    assert decision.chosen is chosen


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_no_decision_contradicts_itself(case):
    """Named causes, ranking, ties, fraction, bound and reason follow from the verdict, in both directions."""
    tuned, models, reached = case
    decision = decided(case)
    named, places, verdict = decision.named, [place for place, _ in decision.shares], decision.verdict
    flexible = reaching(reached)(tuned)
    assert bool(named) == (verdict in NAMING) == (decision.chosen is not tuned)
    assert bool(decision.reason) == (verdict == "cannot_tell")
    assert len(set(places)) == len(places) == len(decision.models)
    for place, model in zip(places, decision.models, strict=True):
        assert place in model.fit.locations
    if verdict == "no_gap":
        assert decision.explained == 1.0
        assert not places and not decision.equivalent
    elif not named:
        singles = {each.fit.locations for each in without_needless([m for m in models if len(m.fit.effects) == 1])}
        assert decision.explained == 0.0
        size = len(ladder(tuned, models)[-1].fit.effects) if decision.equivalent else 1
        assert all(len(model.fit.effects) == size for model in decision.models)
        if decision.equivalent:
            assert "causes explain" in decision.reason and verdict == "cannot_tell"
            large = compared([m for m in models if len(m.fit.effects) == size])
            assert set(places) == {p for m in large for p in m.fit.locations}, "every cause in a model of that size"
            assert set(decision.equivalent) <= set(places), "a tied cause is ranked"
        else:
            assert {(place,) for place in places} == singles, "every single cause is ranked, and nothing else"
    else:
        parts = parts_by_hand(tuned, decision.chosen, flexible)
        all_of_it = parts_by_hand(tuned, decision.chosen, None)
        largest = answer(tuned, models)[1]
        whole = decision.chosen is largest and min(*parts, *all_of_it) >= NUMBERS.complete
        assert (verdict == "main_effect") == (not whole)
        assert (verdict == "effect") == (whole and len(named) == 1)
        assert (verdict == "several_effects") == (whole and len(named) > 1)
        assert decision.explained == pytest.approx(max(parts)) and decision.explained >= NUMBERS.most
        assert max(all_of_it) >= NUMBERS.substantial
        assert decision.equivalent[: len(named)] == named, "the named causes first, then those tied with them"
        assert len(set(decision.equivalent)) == len(decision.equivalent)
        assert set(named) <= set(places), "a cause that is named is ranked"
        assert all(m is decision.chosen for p, m in zip(places, decision.models, strict=True) if p in named)
        assert decision.chosen.score < tuned.score
        if decision.chosen is largest:
            assert set(decision.equivalent) <= {
                p for m in models if len(m.fit.effects) == len(named) for p in m.fit.locations
            }
        else:
            assert decision.equivalent == named


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_fractions_are_those_of_the_definition(case):
    tuned, models, bound = case
    flexible = reaching(bound)(tuned)
    for each in models:
        assert fractions(tuned, each, flexible) == pytest.approx(parts_by_hand(tuned, each, flexible))
        assert fractions(tuned, each) == pytest.approx(parts_by_hand(tuned, each, None))


def test_a_limit_that_is_reached_twice_is_accepted_beside_small_errors_of_another_kind():
    """Resamples often miss both segments; but the larger model leaves no such error anywhere."""
    tuned, limited = evaluated([9.0] * 38 + [4e4] * 2), even(9.0, BACKLASH)
    assert not significantly_worse(tuned, limited)
    assert decide(tuned, [limited], reaching(3.0)).named == (BACKLASH,)
    shared = evaluated([9.0] * 37 + [4e4] * 1 + [9.0] * 2, BACKLASH)  # one of the two stays
    assert not decide(tuned, [shared], reaching(3.0)).named


def test_fractions_in_numbers():
    """Errors 10 before, 5 after, 2 with a flexible torque: 5 of 8; of all above the noise 5 of 9."""
    tuned, model = even(100.0), even(25.0, COULOMB)
    assert fractions(tuned, model, even(4.0)) == pytest.approx((5.0 / 8.0, 5.0 / 8.0))
    assert fractions(tuned, model) == pytest.approx((5.0 / 9.0, 5.0 / 9.0))
    assert fractions(tuned, even(0.3, COULOMB)) == (1.0, 1.0), "below the noise counts as noise"
    assert fractions(tuned, model, even(64.0)) == (1.0, 1.0), "a flexible torque that is worse is no bound"
    assert fractions(even(0.9), even(0.8, COULOMB)) == (1.0,), "where there is nothing to explain"
    rare = evaluated([1.0] * 39 + [4000.0])  # a limit reached once: all of the root mean square, little that is typical
    root, typical = fractions(rare, even(1.0, COULOMB), even(1.0))
    assert (root, typical) == (1.0, 1.0)
    root, typical = fractions(evaluated([9.0] * 39 + [4000.0]), evaluated([9.0] * 40, COULOMB), even(1.0))
    assert root == pytest.approx((np.sqrt(108.775) - 3.0) / (np.sqrt(108.775) - 1.0)) and typical < 0.25


def test_a_typical_segment_without_an_error_does_not_count_as_explained():
    """A wall that is touched once: a cause that explains two thirds of the error there is not the cause."""
    tuned, part = evaluated([0.4] * 39 + [4e4]), evaluated([0.4] * 39 + [5e3], BACKLASH)
    assert fractions(tuned, part, even(0.4)) == pytest.approx((0.667,), abs=1e-3)
    assert decide(tuned, [part], reaching(0.4)).verdict == "unknown"
    assert decide(tuned, [even(0.4, COULOMB)], reaching(0.4)).verdict == "effect"


def test_models_with_the_same_losses_are_one_model_under_several_names():
    """Shifts of the loss, as parts of SAME * margin = .003: each is compared with those already counted."""
    near = SAME * NUMBERS.margin

    def shifted(loss: float, place: Location) -> Evaluation:
        return evaluated(np.expm1(np.full(SEGMENTS, 1.0 + loss)), place)

    one = shifted(0.0, COULOMB)
    assert _agreeing([one]) == [0]
    assert _agreeing([one, shifted(0.9 * near, BACKLASH), shifted(-0.9 * near, INERTIA)]) == [0, 0, 0]
    assert _agreeing([one, shifted(1.1 * near, BACKLASH)]) == [0, 1]
    assert _agreeing([one, shifted(0.6 * near, BACKLASH), shifted(1.2 * near, INERTIA)]) == [0, 0, 2]
    apart = 1.0 + 5.0 * near * (-1.0) ** np.arange(SEGMENTS)  # as good on average, and in no segment
    assert _agreeing([one, evaluated(np.expm1(apart), BACKLASH)]) == [0, 1]


def test_tied_models_count_by_how_likely_they_are():
    """Three or four equal ones, one of them under two names, and one that is nearly certain beside three others."""
    places = (BACKLASH, INERTIA, DRAG, COULOMB)
    equal = [even(1.0 + 0.01 * k, place) for k, place in enumerate(places)]
    assert doubt(equal[:1]) == pytest.approx(1.0) and doubt(equal) == pytest.approx(4.0)
    names = [even(1.0, BACKLASH), even(1.0, STRIBECK), even(1.01, INERTIA)]  # parts 2/3 and 1/3
    expected = np.exp(np.log(3.0) - 2.0 / 3.0 * np.log(2.0))
    assert doubt(names) == pytest.approx(expected)
    beyond = 4.0 * NUMBERS.margin + 0.01 * np.arange(3)
    behind = [even(float(np.expm1(np.log(2.0) + each)), place) for each, place in zip(beyond, places[1:], strict=True)]
    weights = np.append(1.0, np.exp(1.0 - beyond / NUMBERS.margin))
    shares = weights / weights.sum()
    assert doubt([equal[0], *behind]) == pytest.approx(np.exp(-np.sum(shares * np.log(shares))))
    assert doubt([equal[0], *behind]) < 2.0


def test_alternatives_of_two_effects_do_not_multiply():
    """Delay or lag beside inertia or payload: four models, two alternatives in each place."""
    tuned = even(100.0)
    four = [even(1.0 + 0.01 * k, *each) for k, each in enumerate(product((DRAG, VISCOUS), (INERTIA, PAYLOAD)))]
    assert doubt(four) == pytest.approx(2.0)
    assert decide(tuned, four, reaching(1.0)).verdict == "several_effects"
    third = [even(1.0 + 0.01 * k, DRAG, place) for k, place in enumerate((INERTIA, PAYLOAD, BACKLASH, DAMPING))]
    assert doubt(third) == pytest.approx(4.0)
    assert decide(tuned, third, reaching(1.0)).verdict == "cannot_tell"
    assert decide(tuned, [*third, even(1.5, DRAG)], reaching(1.0)).named == (DRAG,)


def test_an_effect_that_contains_a_plainer_one_stands_in_the_same_place():
    """Coulomb or Stribeck friction, beside one of four other effects: dry friction is certain."""
    tuned, frictions = even(100.0), (COULOMB, STRIBECK, COULOMB, STRIBECK)
    four = [even(1.0 + 0.01 * k, *each) for k, each in enumerate(zip(frictions, (INERTIA, BACKLASH, DRAG, DAMPING)))]
    assert decide(tuned, four, reaching(1.0)).verdict == "cannot_tell"
    assert decide(tuned, [*four, even(1.5, COULOMB)], reaching(1.0)).named == (COULOMB,)


def test_what_tied_models_have_in_common_is_a_model_that_was_compared():
    pairs = [even(1.0, COULOMB, BACKLASH), even(1.0, INERTIA, COULOMB), even(1.0, COULOMB, DRAG)]
    alone, other = even(2.0, COULOMB), even(2.0, INERTIA)
    assert common_part(pairs, [*pairs, other, alone]) is alone
    assert common_part(pairs, [even(2.5, STRIBECK), alone]) is alone  # the plainest of those with a dry friction
    assert common_part(pairs, [*pairs, other]) is None  # nobody compared it
    assert common_part([*pairs, even(1.0, INERTIA, DRAG)], [*pairs, other, alone]) is None
    assert common_part([alone, other], [alone, other]) is None
    three = [even(1.0, COULOMB, BACKLASH, place) for place in (INERTIA, DRAG)]
    assert common_part(three, [alone, even(2.0, BACKLASH, COULOMB)]).fit.locations == (BACKLASH, COULOMB)


def test_one_model_under_two_names_has_the_name_with_fewer_parameters():
    """A constant motor torque, and a torque from outside that begins and ends with the log."""
    tuned, short, long = even(100.0), even(1.0005, BACKLASH), even(1.0, STRIBECK)
    assert long.score < short.score and len(long.fit.values) > len(short.fit.values)
    decision = decide(tuned, [long, short], reaching(1.0))
    assert decision.named == (BACKLASH,) and decision.equivalent == (BACKLASH, STRIBECK)
    assert decision.shares == ((BACKLASH, 0.5), (STRIBECK, 0.5))
    assert decide(tuned, [long, even(1.03, BACKLASH)], reaching(1.0)).named == (STRIBECK,)


def test_a_richer_cause_is_tied_unless_it_contains_the_plainer_one():
    """A payload that is seen by its inertia alone; a Stribeck friction that is a Coulomb friction."""
    tuned = even(100.0)
    decision = decide(tuned, [even(1.01, PAYLOAD), even(1.0, INERTIA)], reaching(1.0))
    assert decision.named == (INERTIA,) and decision.equivalent == (INERTIA, PAYLOAD)
    assert decision.shares == ((INERTIA, 0.5), (PAYLOAD, 0.5))
    decision = decide(tuned, [even(0.99, STRIBECK), even(1.0, COULOMB)], reaching(1.0))
    assert decision.named == decision.equivalent == (COULOMB,) and decision.shares == ((COULOMB, 1.0),)


@pytest.mark.parametrize("first", [COULOMB, PAYLOAD])
def test_causes_with_equal_shares_are_ranked_by_the_error_that_each_leaves_alone(first):
    """Neither the order in a model nor the number of parameters decides, nor a score on which the rms disagrees."""
    second = PAYLOAD if first == COULOMB else COULOMB
    rare = evaluated([0.1] * 38 + [400.0] * 2, second)  # smaller in most segments, larger in root mean square
    better = evaluated([9.0] * SEGMENTS, first)
    assert better.score > rare.score and better.rms < rare.rms
    for order in ((first, second), (second, first)):
        pair = even(1.0, *order)
        shares, models = _ranking(pair, pair, [rare, better, pair])
        assert shares == ((first, 1.0), (second, 1.0))
        assert all(each is pair for each in models)
        shares, _ = _ranking(pair, pair, [better, pair])
        assert [place for place, _ in shares] == [first, second], "a cause that was not compared alone comes last"


def test_a_larger_share_comes_before_a_smaller_error_alone():
    named, rival = even(1.0, COULOMB), even(1.1, BACKLASH)
    shares, models = _ranking(named, named, [rival, named])
    assert [place for place, _ in shares] == [COULOMB, BACKLASH]
    assert (models[0], models[1]) == (named, rival)
    beyond = np.log(2.1 / 2.0) - NUMBERS.margin
    weight = float(np.exp(-beyond / NUMBERS.margin))
    assert dict(shares)[BACKLASH] == pytest.approx(weight / (1.0 + weight), abs=1e-6)


def test_a_lead_within_the_margin_is_no_evidence():
    for square, ahead in ((1.03, False), (1.1, True)):  # ln(2.03 / 2) is half the margin
        named, rival = even(1.0, COULOMB), even(square, BACKLASH)
        shares = dict(_ranking(named, named, [rival, named])[0])
        assert (shares[COULOMB] > shares[BACKLASH] + 1e-6) == ahead


def test_a_rival_beside_the_same_effects_takes_its_part_of_the_probability():
    tuned, named = leaving(100.0), leaving(1.2, COULOMB, BACKLASH)
    models = [named, leaving(30.0, COULOMB)]
    alone = decide(tuned, models, reaching(1.0))
    rival = leaving(1.2, DRAG, BACKLASH, seed=3)
    both = decide(tuned, models, reaching(1.0), lambda model: [rival] if model is named else [])
    assert both.verdict == alone.verdict == "several_effects" and both.named == alone.named
    assert DRAG in both.equivalent and DRAG not in alone.equivalent and both.rivals == (rival,)
    assert dict(alone.shares)[COULOMB] == pytest.approx(1.0) and dict(both.shares)[BACKLASH] == pytest.approx(1.0)
    assert dict(both.shares)[COULOMB] == pytest.approx(dict(both.shares)[DRAG], abs=0.2)


def test_a_rival_that_explains_more_is_named():
    """Also within the margin: a cause that is likelier than the named one would contradict the headline."""
    tuned, first = leaving(100.0), leaving(1.25, COULOMB, BACKLASH)
    better = leaving(1.2, DRAG, BACKLASH)
    decision = decide(tuned, [first, leaving(30.0, COULOMB)], reaching(1.0), lambda _model: [better])
    assert decision.named == (DRAG, BACKLASH) and decision.verdict == "several_effects"
    assert decision.equivalent[:2] == decision.named and COULOMB in decision.equivalent
    shares = dict(decision.shares)
    assert shares[DRAG] >= shares[COULOMB] > 0.0 and sum(shares.values()) == pytest.approx(2.0)
    assert dict(zip([place for place, _ in decision.shares], decision.models, strict=True))[DRAG] is better


@pytest.mark.parametrize(("first", "second"), [(STRIBECK, COULOMB), (COULOMB, STRIBECK)], ids=["plainer", "richer"])
def test_a_rival_at_the_same_places_takes_no_part_unless_its_further_parameters_are_needed(first, second):
    tuned, named = leaving(100.0), leaving(1.2, first, BACKLASH)
    rival = leaving(1.19, second, BACKLASH, seed=3)
    decision = decide(tuned, [named, leaving(30.0, first)], reaching(1.0), lambda _model: [rival])
    assert decision.named == (first, BACKLASH) and decision.rivals == ()
    assert dict(decision.shares)[first] == pytest.approx(1.0) and second not in decision.equivalent


def test_pairs_that_tie_are_ranked_as_pairs():
    """What they have in common explains too little alone; each of the others is one of four."""
    rest = (BACKLASH, INERTIA, DRAG, DAMPING)
    pairs = [leaving(1.2, COULOMB, each, seed=i) for i, each in enumerate(rest)]
    decision = decide(leaving(100.0), [*pairs, leaving(60.0, COULOMB)], reaching(1.0))
    assert decision.verdict == "cannot_tell" and set(decision.equivalent) == {COULOMB, *rest}
    shares = dict(decision.shares)
    assert shares[COULOMB] == pytest.approx(1.0)
    assert sum(shares[each] for each in rest) == pytest.approx(1.0) and max(shares[each] for each in rest) < 0.5


@pytest.mark.parametrize(("left", "possible"), [(2.5, True), (1.8, True), (1.05, False)])
def test_a_search_goes_on_as_long_as_something_relevant_may_be_left(left, possible):
    """Whatever comes next leaves noise at best: relevant is 5 % of the error of the tuned device above the noise."""
    tuned, fewer = even(6.0), even(left, COULOMB)
    assert improvable(fewer, tuned) == possible == relevant(even(1.0, COULOMB, DRAG), fewer, tuned)


def test_what_the_best_model_outdoes_has_no_part_of_the_probability():
    """Two segments show which is right; one in eight resamples has neither, and says nothing about that."""
    rare = np.ones(64)
    rare[[20, 41]] = 4e3
    shares, _ = shares_of([evaluated(np.ones(64), COULOMB), evaluated(rare, DRAG)])
    assert dict(shares) == {COULOMB: 1.0, DRAG: 0.0}
    rare[[20, 41]] = 30.0  # small enough to be noise that is underestimated
    shares, _ = shares_of([evaluated(np.ones(64), COULOMB), evaluated(rare, DRAG)])
    assert 0.0 < dict(shares)[DRAG] < 0.3


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_shares_are_sorted_and_add_up_to_the_number_of_effects(case):
    decision = decided(case)
    shares = [share for _, share in decision.shares]
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 <= share <= 1.0 for share in shares)
    if decision.named or decision.equivalent:
        tuned, models, _ = case
        assert sum(shares) == pytest.approx(len(ladder(tuned, models)[-1].fit.effects))
    else:
        assert sum(shares) <= 1.0 + 1e-9  # the rest is that of no effect


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_a_cause_that_is_likelier_than_the_one_named_is_said_to_do_as_well(case):
    decision = decided(case)
    if len(decision.named) == 1:
        known = dict(decision.shares)
        likelier = {place for place, share in known.items() if share > known[decision.named[0]]}
        assert likelier <= set(decision.equivalent)


@settings(max_examples=100, deadline=None)
@given(evidence(), st.integers(0, 1000))
def test_the_order_in_which_models_were_fitted_decides_nothing(case, seed):
    tuned, models, bound = case
    first, again = decided(case), decided((tuned, list(np.random.default_rng(seed).permutation(models)), bound))
    assert (first.verdict, first.named, set(first.equivalent)) == (again.verdict, again.named, set(again.equivalent))


@settings(max_examples=200, deadline=None)
@given(evidence())
def test_every_step_of_the_ladder_matters(case):
    tuned, models, _ = case
    steps = ladder(tuned, models)
    assert steps[0] is tuned
    assert [len(a.fit.effects) < len(b.fit.effects) for a, b in pairwise(steps)] == [True] * (len(steps) - 1)
    for fewer, more in pairwise(steps):
        errors = [(each.rms, each.typical) for each in (tuned, fewer, more)]
        remaining = fewer.mean_square > NUMBERS.no_gap
        assert any(
            (remaining and b - c > NUMBERS.remaining * (b - 1.0)) or b - c > NUMBERS.material * (a - 1.0)
            for a, b, c in zip(*errors, strict=True)
        )
        assert more.score < fewer.score - NUMBERS.margin


def even(square: float, *locations: Location) -> Evaluation:
    """A model that leaves exactly as much in every segment."""
    return evaluated(np.full(SEGMENTS, square), *locations)


def leaving(square: float, *locations: Location, seed: int = 0) -> Evaluation:
    """A model that leaves about as much everywhere."""
    wobble = 0.05 * np.random.default_rng(seed).normal(size=SEGMENTS)
    return evaluated(square * np.exp(wobble), *locations)


def test_noise_alone_is_no_gap():
    assert decide(leaving(1.9), [leaving(1.0, COULOMB)], reaching(1.0)).verdict == "no_gap"


@pytest.mark.parametrize("held_out", [1.0, 1.2, 1.9])
@pytest.mark.parametrize("fitted", [4e4, 200.0], ids=["push", "less than the noise may be wrong"])
def test_an_error_in_fitted_segments_alone_is_no_cause_and_no_small_one_a_gap(held_out, fitted):
    """Held-out segments show nothing about it, so what lowers the noise there is not its cause."""
    tuned = replace(even(held_out), fitted=np.where(np.arange(SEGMENTS) < 1, fitted, 1.0))
    small = tuned.on_all.mean_square <= NUMBERS.no_gap**2
    assert noise_only(tuned) and no_gap(tuned) == small == (fitted == 200.0)
    better = replace(even(held_out - 0.3, COULOMB), fitted=tuned.fitted)
    for models in ([], [better], [replace(better, fitted=np.ones(SEGMENTS))]):
        decision = decide(tuned, models, reaching(held_out - 0.3))
        assert decision.verdict == ("no_gap" if small else "cannot_tell") and not decision.named


@pytest.mark.filterwarnings("error")  # of means of nothing
@pytest.mark.parametrize("everywhere", [True, False])
def test_what_is_named_beside_an_event_has_to_show_elsewhere(everywhere):
    """A push has another shape than that of the model; a torque limit may imitate the difference."""
    at_push = np.arange(SEGMENTS) < 6
    before = 9.0 if everywhere else 1.0
    errors = [np.where(at_push, at, left) for at, left in ((4e4, before), (400.0, before), (9.0, 1.0))]
    push = Location("external_torque", "environment", 0)
    models = [
        replace(evaluated(each, *places), shared=at_push, fitted=each)
        for each, places in zip(errors, ((), (push,), (push, BACKLASH)), strict=True)
    ]
    assert accepted(models[1], models[0], models[0])
    assert accepted(models[2], models[1], models[0]) == everywhere
    assert len(models[1].apart.segments) == SEGMENTS - 6 and relevant(models[2], models[1], models[0])
    nothing_else = [replace(each, shared=np.ones(SEGMENTS, dtype=np.bool_)) for each in models]
    assert not accepted(nothing_else[2], nothing_else[1], nothing_else[0])


def test_noise_alone_is_a_gap_where_an_effect_takes_the_place_of_a_parameter_at_its_bound():
    tuned = at_bound(leaving(1.9))
    assert decide(tuned, [leaving(1.0, COULOMB)], reaching(1.0)).verdict == "effect"
    assert decide(tuned, [leaving(1.88, COULOMB)], reaching(1.0)).verdict == "no_gap"
    assert decide(tuned, [], reaching(1.0)).verdict == "no_gap"


@pytest.mark.parametrize(
    ("left", "bound", "verdict"),
    [(1.0, 1.0, "effect"), (3.0, 1.0, "main_effect"), (40.0, 1.0, "unknown"), (40.0, 6.2, "main_effect")],
    ids=["all", "most of it", "some of it", "all that can be"],
)
def test_how_much_is_explained_of_what_can_be(left, bound, verdict):
    decision = decide(leaving(100.0), [leaving(left, BACKLASH), leaving(90.0, PAYLOAD)], reaching(bound))
    assert decision.verdict == verdict
    assert decision.named == ((BACKLASH,) if verdict != "unknown" else ())
    assert decision.shares[0][0] == BACKLASH


@pytest.mark.parametrize(("left", "verdict"), [(1.0, "effect"), (40.0, "main_effect")])
def test_an_answer_is_complete_only_if_it_explains_the_fitted_segments_too(left, verdict):
    """Held-out motion may be too poor to show what is missing."""
    tuned = replace(leaving(100.0), fitted=np.full(60, 100.0))
    model = replace(leaving(1.0, BACKLASH), fitted=np.full(60, left))
    decision = decide(tuned, [model], reaching(1.0))
    assert decision.verdict == verdict and decision.named == (BACKLASH,)


def test_a_second_effect_is_named_where_it_matters_and_not_where_it_does_not():
    tuned, best = leaving(100.0), leaving(5.0, BACKLASH)
    both = leaving(1.0, BACKLASH, PAYLOAD, seed=1)
    assert decide(tuned, [best, both], reaching(1.0)).verdict == "several_effects"
    assert set(decide(tuned, [best, both], reaching(1.0)).named) == {BACKLASH, PAYLOAD}
    hardly = leaving(4.8, BACKLASH, PAYLOAD)
    assert decide(tuned, [best, hardly], reaching(1.0)).named == (BACKLASH,)


def test_an_effect_that_is_small_beside_the_first_is_named_where_it_explains_most_of_the_rest():
    """3 % of the error either way: clear of the noise it is a second cause, near the noise it is none."""
    first, both = leaving(100.0, BACKLASH), leaving(49.0, BACKLASH, PAYLOAD, seed=1)
    assert decide(leaving(10000.0), [first, both], reaching(1.0)).named == (BACKLASH,)
    both = leaving(16.0, BACKLASH, PAYLOAD, seed=1)
    decision = decide(leaving(10000.0), [first, both, leaving(5000.0, PAYLOAD)], reaching(1.0))
    assert decision.verdict == "several_effects"
    assert [place for place, _ in decision.shares] == [BACKLASH, PAYLOAD], "what explains more alone comes first"
    first, both = leaving(1.9, BACKLASH), leaving(1.0, BACKLASH, PAYLOAD, seed=1)
    assert decide(leaving(10000.0), [first, both], reaching(1.0)).named == (BACKLASH,)


def test_the_richer_effect_at_a_place_is_not_named_where_the_plainer_does_as_well():
    tuned = leaving(100.0)
    decision = decide(tuned, [leaving(1.2, COULOMB), leaving(1.19, STRIBECK, seed=1)], reaching(1.0))
    assert decision.named == (COULOMB,) and decision.equivalent == (COULOMB,)
    decision = decide(tuned, [leaving(4.0, COULOMB), leaving(1.0, STRIBECK, seed=1)], reaching(1.0))
    assert decision.named == (STRIBECK,) and decision.equivalent == (STRIBECK,)


def test_causes_that_do_as_well_as_one_another_are_named_together_up_to_three():
    tuned, each = leaving(100.0), (COULOMB, BACKLASH, INERTIA, DRAG)
    three = [leaving(1.2, place, seed=i) for i, place in enumerate(each[:3])]
    decision = decide(tuned, three, reaching(1.0))
    assert decision.verdict == "effect" and set(decision.equivalent) == set(each[:3])
    four = decide(tuned, [*three, leaving(1.2, DRAG, seed=4)], reaching(1.0))
    assert four.verdict == "cannot_tell" and not four.named
    assert set(four.equivalent) == set(each) and "4 causes" in four.reason


def test_what_repeats_with_no_motion_is_not_explained_by_whatever_helps_a_little():
    """A flexible model reaches little more than the effect does, and nearly all of the error stays."""
    decision = decide(leaving(100.0), [leaving(81.0, INERTIA)], reaching(8.9))
    assert decision.verdict == "cannot_tell" and "link_inertia" in decision.reason
    decision = decide(leaving(100.0), [leaving(99.0, VISCOUS)], reaching(9.9))
    assert decision.verdict == "cannot_tell" and "does not repeat" in decision.reason


def test_the_best_of_models_is_taken_unless_a_plainer_one_at_its_place_does_as_well():
    good = [leaving(1.20, STRIBECK), leaving(1.21, DAMPING, seed=2), leaving(2.0, COULOMB)]
    assert simplest(good).fit.locations == (STRIBECK,)
    assert simplest([*good, leaving(1.22, VISCOUS, seed=3)]).fit.locations == (DAMPING,)


def test_an_event_that_does_nothing_is_not_accepted_for_what_its_companion_explains():
    """Beside the smaller model the largest error falls tenfold, but so it does without the event."""
    tuned = even(1e4)
    push = Location("external_torque", "environment", 0)

    def rare(square: float, *locations: Location) -> Evaluation:  # in too few segments for resamples
        return evaluated(np.where(np.arange(SEGMENTS) < 2, square, 1.0), *locations)

    small, same, more = rare(4e4, DRAG), rare(4e3, DRAG, INERTIA), rare(4e3, DRAG, INERTIA, push)
    assert event_times(more.fit)
    assert accepted(more, small, tuned)
    assert not accepted(more, small, tuned, [small, same, more])
    assert accepted(rare(40.0, DRAG, INERTIA, push), small, tuned, [small, same])
