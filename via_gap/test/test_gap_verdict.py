"""One decision: whatever the evidence, what it says about itself agrees; and plain cases are answered plainly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from gap_models import BACKLASH, COULOMB, DAMPING, DRAG, INERTIA, PAYLOAD, PLACES, STRIBECK, VISCOUS, evaluated
from hypothesis import given, settings
from hypothesis import strategies as st
from via_gap.candidates.location import Location
from via_gap.selection.evidence import Evaluation
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.verdict import Decision, decide, fractions, ladder, simplest

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
    return leaving(most), models, float(np.exp(0.5 * most * draw(st.floats(0.0, 1.0))))


def decided(case: tuple[Evaluation, list[Evaluation], float]) -> Decision:
    tuned, models, bound = case
    return decide(tuned, models, reaching(bound))


def reaching(rms: float) -> Callable[[Evaluation], Evaluation]:
    """A flexible model that leaves as much, whatever it stands beside."""
    return lambda each: replace(each, segments=np.full(SEGMENTS, rms**2))


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_no_decision_contradicts_itself(case):
    tuned, decision = case[0], decided(case)
    named, places = decision.named, [place for place, _ in decision.shares]
    assert bool(named) == (decision.verdict in NAMING)
    assert (decision.chosen is tuned) == (not named)
    assert bool(decision.reason) == (decision.verdict == "cannot_tell")
    if decision.verdict == "effect":
        assert len(named) == 1
    if decision.verdict == "several_effects":
        assert len(named) >= 2
    if named:
        flexible = reaching(case[2])(tuned)
        reached, of_all = fractions(tuned, decision.chosen, flexible), fractions(tuned, decision.chosen)
        assert decision.explained >= NUMBERS.most and max(of_all) >= NUMBERS.substantial
        assert decision.verdict == "main_effect" or min(*reached, *of_all) >= NUMBERS.complete
        assert decision.explained == max(reached)
    if named:
        assert set(named) <= set(decision.equivalent)
        assert set(named) <= set(places), "a cause that is named is ranked"
        assert all(m is decision.chosen for p, m in zip(places, decision.models, strict=True) if p in named)
        assert decision.chosen.score < tuned.score
    else:
        assert decision.explained == (1.0 if decision.verdict == "no_gap" else 0.0)
        assert not decision.equivalent or decision.verdict == "cannot_tell"
    assert decision.bound <= max(decision.chosen.rms, tuned.rms)
    assert len(set(places)) == len(places)
    for place, model in zip(places, decision.models, strict=True):
        assert place in model.fit.locations


@settings(max_examples=300, deadline=None)
@given(evidence())
def test_shares_are_sorted_and_add_up_to_the_number_of_effects(case):
    decision = decided(case)
    shares = [share for _, share in decision.shares]
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 <= share <= 1.0 for share in shares)
    if decision.named:
        assert sum(shares) == pytest.approx(len(decision.named))
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


def leaving(square: float, *locations: Location, seed: int = 0) -> Evaluation:
    """A model that leaves about as much everywhere."""
    wobble = 0.05 * np.random.default_rng(seed).normal(size=SEGMENTS)
    return evaluated(square * np.exp(wobble), *locations)


def test_noise_alone_is_no_gap():
    assert decide(leaving(1.5), [leaving(1.0, COULOMB)], reaching(1.0)).verdict == "no_gap"


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
