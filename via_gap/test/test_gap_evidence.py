"""Held-out evidence: equal models are kept, worse ones eliminated, and no more often wrongly than is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import log_of, rigid
from gap_models import BACKLASH, COULOMB, STRIBECK, VISCOUS, evaluated
from scipy.stats import ttest_1samp
from via_core.signals import Array
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.diagnosis import diagnose
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.selection import reliability
from via_gap.selection.confidence_set import confidence_set
from via_gap.selection.evidence import (
    block_means,
    difference,
    evaluate,
    freedom,
    least_difference,
    outdone_by,
    plainer,
    predicts,
    refuted_beside,
    resamples,
    significantly_worse,
    vetoed,
)
from via_gap.selection.numbers import NUMBERS
from via_gap.selection.verdict import accepted
from via_sim.effects import Effect

PUSH = Location("external_torque", "environment", 0)
BLOCKS = 40
ALPHA = 0.05
PICKS = np.random.default_rng(7).integers(0, BLOCKS, (400, BLOCKS))
SEEDS = 200


def losses(*means: float, noise: float = 0.1, seed: int = 0) -> Array:
    """(K, BLOCKS) independent losses with these means."""
    return np.array(means)[:, None] + noise * np.random.default_rng(seed).normal(size=(len(means), BLOCKS))


def kept(values: Array, margin: float = 0.0, alpha: float = ALPHA) -> list[int]:
    return [int(k) for k in confidence_set(values, PICKS, margin, alpha)[0]]


def test_identical_models_are_all_kept_and_one_alone_is_itself():
    assert sorted(kept(np.tile(losses(1.0), (5, 1)))) == [0, 1, 2, 3, 4]
    indices, membership = confidence_set(losses(1.0), PICKS, 0.0, ALPHA)
    assert (list(indices), list(membership)) == ([0], [1.0])


def test_models_that_are_as_good_are_kept_as_often_as_stated():
    """The set must hold the best of three models with probability 1 - alpha; ties hold all with that probability."""
    whole = sum(len(kept(losses(1.0, 1.0, 1.0, seed=seed))) == 3 for seed in range(SEEDS)) / SEEDS
    assert whole > 1.0 - ALPHA - 3.0 * np.sqrt(ALPHA * (1.0 - ALPHA) / SEEDS)
    strict = sum(len(kept(losses(1.0, 1.0, 1.0, seed=seed), alpha=0.5)) == 3 for seed in range(SEEDS)) / SEEDS
    assert strict < whole - 0.2  # which a set that keeps everything would not be


@pytest.mark.parametrize(("worse", "least", "most"), [(0.2, 0.99, 1.0), (0.06, 0.4, 0.95), (0.0, 0.0, 0.06)])
def test_a_worse_model_goes_as_surely_as_its_difference_is_large(worse, least, most):
    """Of .06 with a standard deviation .1 sqrt(2/40) = .022 the one-sided test of two models rejects in 86 %."""
    gone = sum(1 not in kept(losses(1.0, 1.0 + worse, seed=seed)) for seed in range(SEEDS)) / SEEDS
    assert least <= gone <= most


def test_a_difference_within_the_margin_does_not_matter_however_well_it_is_known():
    certain = losses(1.0, 1.02, 1.2, noise=1e-6)
    assert kept(certain) == [0]
    assert kept(certain, margin=0.03) == [0, 1]


def test_models_are_listed_best_first_with_membership_that_says_when_each_went():
    indices, membership = confidence_set(losses(1.02, 1.0, 1.5, 1.03, noise=0.05), PICKS, 0.03, ALPHA)
    assert list(indices) == [1, 0, 3]
    assert membership[1] == 1.0 and membership[2] <= ALPHA < membership[0]


def test_what_segments_have_in_common_takes_no_part_in_a_comparison():
    shared = 3.0 * np.random.default_rng(1).normal(size=BLOCKS)
    assert kept(losses(1.0, 1.2, noise=0.02) + shared) == [0]


def test_one_model_is_clearly_worse_beyond_margin_and_noise():
    rng = np.random.default_rng(3)
    good = np.exp(1.0 + 0.5 * rng.normal(size=60))
    for ratio, worse in ((1.0, False), (1.02, False), (1.2, True)):
        a, b = evaluated(ratio * (1.0 + good) - 1.0, COULOMB), evaluated(good, BACKLASH)
        assert significantly_worse(a, b) is worse  # log(1 + z^2) differs by log(ratio) in every segment
        assert difference(a, b) == (pytest.approx(np.log(ratio)), pytest.approx(0.0, abs=1e-12))
        assert not significantly_worse(b, a)


def test_false_alarms_of_a_comparison_are_as_rare_as_stated():
    """Two models whose true losses differ by the margin: one is called worse in `significance` of the cases."""

    def once(seed: int) -> bool:
        rng = np.random.default_rng(seed)
        a, b = (np.exp(2.0 + shift + 0.4 * rng.normal(size=80)) - 1.0 for shift in (NUMBERS.margin, 0.0))
        return significantly_worse(evaluated(a, COULOMB, block=1), evaluated(b, BACKLASH, block=1))

    share = sum(once(seed) for seed in range(2 * SEEDS)) / (2 * SEEDS)
    assert share == pytest.approx(NUMBERS.significance, abs=0.035)


@pytest.mark.parametrize("count", [5, 7])
def test_few_segments_do_not_raise_false_alarms(count):
    """As rare as stated with five segments, too: the normal quantile and an sd without n - 1 would be too small."""
    rng = np.random.default_rng(8)
    pairs = np.exp(8.0 + rng.normal(size=(1500, 2, count)))  # far above the noise, where losses are logarithms
    wrong = [significantly_worse(*(evaluated(each, block=1) for each in pair)) for pair in pairs]
    assert 0.02 < np.mean(wrong) <= NUMBERS.significance + 0.005


def test_a_single_run_has_no_known_scatter():
    a, b = evaluated([9.0], whole=True), evaluated([4.0], whole=True)
    assert difference(a, b)[1] == 0.0 and significantly_worse(a, b)


def test_the_lower_end_is_that_of_a_t_test():
    rng = np.random.default_rng(9)
    a, b = (evaluated(np.expm1(level + rng.normal(size=12)), block=1) for level in (6.0, 5.0))
    found = ttest_1samp(np.log1p(a.segments) - np.log1p(b.segments), 0.0, alternative="greater")
    assert least_difference(a, b) == pytest.approx(found.confidence_interval(0.95).low)
    assert difference(a, b)[0] / difference(a, b)[1] == pytest.approx(found.statistic)


def test_fitted_segments_count_where_held_out_ones_agree():
    """Of six held-out segments one is worse; of eighteen fitted ones all are better."""
    held, fitted = np.full(6, 100.0), np.full(18, 100.0)
    better = np.array([20.0, 20.0, 1000.0, 20.0, 20.0, 20.0])
    alone = evaluated(held, COULOMB, block=1), evaluated(better, BACKLASH, block=1)
    assert not significantly_worse(*alone) and difference(*alone)[0] > 0.5
    both = replace(alone[0], fitted=fitted), replace(alone[1], fitted=np.full(18, 30.0))
    assert significantly_worse(*both)
    unlike = replace(alone[1], segments=1.1 * held, fitted=np.full(18, 1.0))
    assert not significantly_worse(both[0], unlike)  # overfitted: worse where it was not fitted
    assert not significantly_worse(both[0], alone[1])  # not fitted to the same segments


def test_a_model_predicts_where_a_line_errs_in_fitted_and_held_out_segments_alike():
    """Losses lower by .04 in every segment in which the line errs, and not in those where the joint rests."""
    rng = np.random.default_rng(4)
    line = [np.expm1(4.0 + rng.normal(size=n)) for n in (12, 8)]
    own = [(1.0 + each) * np.exp(-0.04) - 1.0 for each in line]
    rest = np.full(30, 0.5)
    without, model = (
        replace(evaluated(np.append(held, rest), block=1), fitted=np.append(fitted, rest))
        for fitted, held in (line, own)
    )
    assert predicts(model, without) and not predicts(without, model)
    assert not predicts(replace(model, segments=without.segments), without)  # .024 on average


def test_a_needless_parameter_explains_one_segment():
    """Regression of noise on k columns reduces the sum of S squares by k / S on average: no more than is subtracted."""
    rng = np.random.default_rng(2)
    count, columns, gains = 40, 6, []
    for _ in range(300):
        noise, design = rng.normal(size=count), rng.normal(size=(count, columns))
        left = noise - design @ np.linalg.lstsq(design, noise, rcond=None)[0]
        gains.append(1.0 - np.sum(left**2) / np.sum(noise**2))
    assert np.mean(gains) == pytest.approx(columns / count, rel=0.1)
    many, few = evaluated([0.9] * 20, STRIBECK, COULOMB), evaluated([1.0] * 20, COULOMB)
    assert freedom(many.fit) - freedom(few.fit) == 3
    few, many = replace(few, segments=np.full(20, 100.0)), replace(many, segments=np.full(20, 85.0))
    assert significantly_worse(few, many)
    fitted = [replace(each, fitted=each.segments) for each in (few, many)]
    assert significantly_worse(*fitted)  # log(100 / 85) = .16 is more than 3 / 40 and the margin
    fitted = [replace(each, fitted=each.segments[:1], segments=each.segments[:15]) for each in (few, many)]
    assert not significantly_worse(*fitted)  # 3 / 16 is more


def test_a_form_with_more_parameters_needs_a_smaller_loss_by_the_margin():
    few = evaluated(np.full(8, 99.0), COULOMB)
    richer = [evaluated(100.0 * np.exp(-less) * np.ones(8) - 1.0, COULOMB, VISCOUS) for less in (0.02, 0.04)]
    assert plainer(few, richer[0]) is few and plainer(richer[1], few) is richer[1]


def test_neighbouring_segments_that_err_alike_are_no_further_evidence():
    """Errors that last four segments: taken one by one they would seem twice as well known."""
    rng = np.random.default_rng(5)
    lasting = np.repeat(0.3 * rng.normal(size=20), 4)
    a, b = np.exp(1.0 + lasting), np.full(80, np.e)
    alone, together = (difference(evaluated(a, block=n), evaluated(b, block=n))[1] for n in (1, 4))
    assert together == pytest.approx(2.0 * alone, rel=0.2)


def test_blocks_are_at_least_four():
    values = np.arange(10.0)[None]
    assert block_means(values, 3).tolist() == [[0.5, 2.5, 4.5, 6.5, 8.5]]
    assert block_means(np.arange(20.0)[None], 5).tolist() == [[2.0, 7.0, 12.0, 17.0]]
    assert np.array_equal(resamples(9), resamples(9)) and resamples(9).max() == 8


def test_the_other_view_contradicts_where_its_error_grows():
    rng = np.random.default_rng(2)
    seen = np.exp(rng.normal(size=40))
    reference = evaluated(np.full(40, 9.0), other_view=seen)
    assert vetoed(evaluated(np.full(40, 2.0), COULOMB, other_view=1.5 * seen + 0.5), reference)
    assert not vetoed(evaluated(np.full(40, 2.0), COULOMB, other_view=seen), reference)
    assert not vetoed(evaluated(np.full(40, 2.0), COULOMB, other_view=0.1 * seen), reference)
    assert not vetoed(evaluated(np.full(40, 2.0), COULOMB), reference)  # which has no other view


def test_whole_runs_are_compared_by_squared_error():
    a, b = ([1000.0, 9.0, 1000.0, 9.0], [900.0, 30.0, 900.0, 30.0])
    assert evaluated(a, whole=True).score > evaluated(b, whole=True).score  # segment by segment the other way round
    assert evaluated(a).score < evaluated(b).score
    one, other = evaluated(a, whole=True), evaluated(b, whole=True)
    assert difference(one, other)[0] == pytest.approx(one.score - other.score, rel=1e-3)


@pytest.mark.parametrize(
    ("left", "better", "refuted"),
    [
        (16.1, 4.0, True),  # noise known to a factor of two on either side, squared
        (15.9, 4.0, False),
        (1000.0, 4.1, False),  # the better one leaves more than noise can be
        (4.1, 0.5, True),  # below the noise counts as noise
        (3.9, 0.5, False),
    ],
)
def test_a_model_is_refuted_beside_one_that_leaves_noise_where_noise_cannot_be_so_large(left, better, refuted):
    assert NUMBERS.no_gap == 2.0
    a, b = evaluated(np.full(20, left), COULOMB), evaluated(np.full(20, better), BACKLASH)
    assert refuted_beside(a, b) is refuted
    assert not refuted_beside(b, a)


def test_an_effect_that_acts_in_one_segment_of_forty_is_clear_where_all_of_it_is_explained():
    """One segment makes the mean so uncertain that its interval reaches below the margin."""
    rare = np.ones(40)
    rare[17] = 500.0
    without, with_effect = evaluated(rare, COULOMB), evaluated(np.ones(40), BACKLASH)
    assert least_difference(without, with_effect) < NUMBERS.margin < difference(without, with_effect)[0]
    assert significantly_worse(without, with_effect) and not significantly_worse(with_effect, without)
    half = np.ones(40)
    half[17] = 250.0  # what is left there is not noise
    assert not significantly_worse(without, evaluated(half, BACKLASH))


def test_what_cannot_be_noise_counts_in_fitted_segments_too_where_held_out_ones_show_it():
    """A limit that is reached three times, once in held-out segments: together they refute the model without it."""
    held, own = np.ones(64), np.ones(95)
    held[[20, 21]], own[[30, 31, 77]] = (150.0, 30.0), (2e4, 5e3, 3e2)
    without, with_limit = (
        replace(evaluated(left, place), fitted=there)
        for left, there, place in ((held, own, COULOMB), (np.ones(64), np.ones(95), BACKLASH))
    )
    assert not refuted_beside(without, with_limit)
    assert least_difference(without.on_all, with_limit.on_all) < NUMBERS.margin
    assert significantly_worse(without, with_limit) and outdone_by(without, with_limit)
    alone = [replace(each, fitted=np.empty(0)) for each in (without, with_limit)]
    assert not significantly_worse(*alone) and not outdone_by(*alone)
    unseen = [replace(each, segments=np.ones(64)) for each in (without, with_limit)]
    assert not significantly_worse(*unseen), "what held-out segments do not show may be fitted by chance"


def test_a_push_is_clear_beside_errors_of_the_model_that_are_far_above_the_noise():
    """Belt and friction leave up to a hundred times the noise in some segments, the push ten thousand times in two."""
    ordinary = np.random.default_rng(11).lognormal(1.0, 1.5, 55)
    pushed = ordinary.copy()
    pushed[[30, 32]] = 4e4
    without, with_push = evaluated(pushed, COULOMB), evaluated(ordinary, PUSH)
    assert least_difference(without, with_push) < NUMBERS.margin < difference(without, with_push)[0]
    assert with_push.mean_square > NUMBERS.no_gap**2
    assert outdone_by(without, with_push) and not outdone_by(with_push, without)
    assert accepted(with_push, without, without)
    pushed = ordinary.copy()
    pushed[[30, 32]] = 3.0 * ordinary.max()  # as large as errors of this model can be
    assert not outdone_by(evaluated(pushed, COULOMB), with_push)
    assert not outdone_by(evaluated(pushed, COULOMB, whole=True), evaluated(ordinary, PUSH, whole=True))


@pytest.mark.parametrize("whole", [False, True])
def test_an_event_is_beyond_what_a_model_leaves_by_the_scatter_of_its_losses(whole):
    """Five segments with losses around 2: a loss of 7 is an event beside an sd of .2, and hardly beside one of 2."""
    scatter = np.array([-1.2, 0.3, -0.4, 1.5, -0.2])
    scatter *= 1.0 / scatter.std(ddof=1)
    left = {sd: np.expm1(2.0 - sd * scatter.mean() + sd * scatter) for sd in (0.2, 2.0)}
    for sd, certain in ((0.2, True), (2.0, False)):
        pushed = left[sd].copy()
        pushed[0] = np.expm1(7.0)
        a, b = evaluated(pushed, COULOMB, whole=whole), evaluated(left[sd], PUSH, whole=whole)
        assert outdone_by(a, b) is certain
    assert not outdone_by(evaluated([1e6], COULOMB), evaluated([10.0], PUSH))  # one segment shows no scatter


def test_events_are_found_by_chance_as_rarely_as_stated():
    """Losses of two models of one kind: the largest of one is an event of the other in at most 5 % of cases."""
    rng = np.random.default_rng(6)
    pairs = np.expm1(8.0 + rng.normal(size=(2000, 2, 6)))
    found = np.mean([outdone_by(*(evaluated(each) for each in pair)) for pair in pairs])
    assert 0.0 < found <= NUMBERS.significance


def test_the_largest_of_several_events_is_not_the_cause():
    """A cable that snags again and again: an external torque explains the strongest of its blows."""
    left = np.ones(55)
    left[3:43:5] = 5e3
    blows = left.copy()
    blows[50] = 4e4
    assert blows.max() > NUMBERS.no_gap**2 * left.max()
    assert not outdone_by(evaluated(blows, COULOMB), evaluated(left, PUSH))


def test_the_typical_error_is_that_of_the_segment_with_the_mean_loss():
    assert evaluated(np.full(30, 9.0)).typical == pytest.approx(3.0)
    assert evaluated([1.0, 7.0]).typical == pytest.approx(np.sqrt(3.0))  # (1 + 1) (1 + 7) = (1 + 3)^2
    assert evaluated([1.0, 7.0], whole=True).typical == pytest.approx(2.0)  # of whole runs the root mean square
    squares = np.exp(np.random.default_rng(4).normal(1.0, 2.0, 25))
    product = 1.0
    for each in squares:
        product *= (1.0 + each) ** (1.0 / 25.0)
    assert evaluated(squares).typical == pytest.approx(np.sqrt(product - 1.0))
    assert evaluated(squares).typical < evaluated(squares).rms


def test_no_parameter_is_known_better_than_two_simulators_agree(monkeypatch):
    exact = reliability.shipped().model_copy(update={"wider": {"effect": 2.0, "main_effect": 5.0}})
    monkeypatch.setattr(reliability, "shipped", lambda: exact)
    covariance = np.array([[1e-6, 1e-7, 0.0], [1e-7, 4.0, 0.0], [0.0, 0.0, 0.0]])
    wide = reliability.widened(np.array([10.0, -10.0, 7.0]), covariance, "effect")
    assert np.diag(wide) == pytest.approx([4.0 * (1e-6 + 0.03**2), 4.0 * (4.0 + 0.03**2), 0.0])
    assert wide[0, 1] == 4e-7
    assert reliability.wider("main_effect") == 5.0 and reliability.wider("unknown") == 1.0


def test_the_chosen_model_has_the_calibrated_width(monkeypatch):
    log = log_of(rigid(), (Effect("coulomb_friction", "link", {"torque": 0.2}),), seed=4, duration=8.0)
    narrow = diagnose([log], rigid()).causes[0].parameters["torque"]
    factors = {verdict: 2.0 * factor for verdict, factor in reliability.shipped().wider.items()}
    twice = reliability.shipped().model_copy(update={"wider": factors})
    monkeypatch.setattr(reliability, "shipped", lambda: twice)
    report = diagnose([log], rigid())
    wide = report.causes[0].parameters["torque"]
    assert wide.value == narrow.value and wide.sd == pytest.approx(2.0 * narrow.sd)
    assert report.widened == twice.wider[report.verdict]


def test_segments_on_both_sides_count_once_over_all_segments():
    """Those with an event are fitted and held out."""
    log = log_of(rigid(), (), seed=3)
    segments = cut_log(log)
    sides = (np.arange(1, 20), np.arange(15, 30))
    fitted, held = (ResidualModel.of([segments], [side]) for side in sides)
    base = Fit((), np.zeros(len(fitted.nuisances)), 0.0, fitted.residual([fitted.row(())])[0], np.empty((0, 0)))
    (found,) = evaluate(held, [base], None, fitted)
    everything = ResidualModel.of([segments], [np.arange(1, 30)])
    assert np.array_equal(found.shared, np.arange(15, 30) < 20)
    expected = everything.evidence(everything.residual([everything.row(())])[0])
    np.testing.assert_allclose(found.on_all.segments, expected, rtol=1e-9)
    assert len(found.on_all.on_all.segments) == len(expected) and len(found.segments) == 15
