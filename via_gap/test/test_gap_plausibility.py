"""Effects that may not be named: at the end of a range, absent, or without a significant size."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_models import evaluated, scales
from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.selection.comparison import _supported
from via_gap.selection.plausibility import absurd, doubt

NOTHING = np.empty(0)
COULOMB = Location("coulomb_friction", "motor", 1)
PAYLOAD = Location("payload", "link", 0)
GAIN = Location("torque_gain", "motor", 1)
LIMIT = Location("torque_saturation", "motor", 1)


def fit(location: Location, covariance: object, *values: float) -> Fit:
    """A location with its parameters' values, and their covariance (or the standard deviation of each)."""
    given = np.asarray(covariance, dtype=np.float64)
    names = [p.name for p in location.parameters]
    effect = location.effect(dict(zip(names, values, strict=True)))
    return Fit((effect,), np.zeros(2), 0.0, NOTHING, given if given.ndim == 2 else given**2 * np.eye(len(values)))


@pytest.mark.parametrize(("offsets", "plausible"), [(1.5, False), (1.9, False), (2.1, True), (10.0, True)])
def test_a_size_is_named_from_two_standard_deviations_on(offsets, plausible):
    """chi2 with one degree of freedom: 1.96 at 5 %."""
    said = doubt(fit(COULOMB, 0.01, 0.01 * offsets), scales())
    assert said == ("" if plausible else "coulomb_friction at motor 1: its size is consistent with zero")


@pytest.mark.parametrize(("tolerances", "plausible"), [(1.2, False), (1.25, False), (1.4, True), (1.8, True)])
def test_a_size_is_named_if_no_device_parameter_within_its_bound_explains_it(tolerances, plausible):
    """Without the effect the parameter ends at 1.3 tolerances, not at the 1.96 standard deviations of a test."""
    size, noise = 0.01, 1e-4
    found = fit(Location("link_inertia", "link", 0), np.hypot(size, noise), size * tolerances)
    found = replace(found, tolerances=np.array([[size]]))
    assert (doubt(found, scales()) == "") == plausible


def test_a_payload_counts_by_its_product():
    """Mass and distance trade along m l = const: each is known to 90 %, their product to 1 %."""
    mass, distance, along, across = 0.5, 0.2, 0.9, 0.01
    gradient = np.array([1.0 / mass, 1.0 / distance]) / np.sqrt(2.0)
    trade = np.array([mass, -distance]) / np.sqrt(2.0)
    outward = np.outer(gradient, gradient) * (mass * distance) ** 2
    covariance = 2.0 * along**2 * np.outer(trade, trade) + across**2 * outward
    assert np.sqrt(covariance[0, 0]) / mass > 0.8
    assert doubt(fit(PAYLOAD, covariance, mass, distance), scales()) == ""
    unknown = covariance + 2.0 * np.diag([mass, distance]) ** 2
    assert doubt(fit(PAYLOAD, unknown, mass, distance), scales()).endswith("consistent with zero")


def test_a_payload_counts_by_its_inertia_where_its_weight_is_not_known():
    """Twice the mass at 1 / sqrt(2) of the distance has the same inertia, which is known to 1 %."""
    mass, distance, gradient = 0.5, 0.2, np.array([0.2**2, 2.0 * 0.5 * 0.2])
    trade = np.array([mass, -0.5 * distance])
    inward = gradient / (gradient @ gradient) * 0.01 * mass * distance**2
    covariance = 4.0 * np.outer(trade, trade) + np.outer(inward, inward)
    assert doubt(fit(PAYLOAD, covariance, mass, distance), scales()) == ""


def test_an_optional_number_at_the_end_of_its_range_is_a_plainer_effect():
    optional = ("counter_coefficient", "stribeck", "counter_stribeck", "velocity")
    geared = Location("load_dependent_friction", "link", 0, optional)
    highest = {p.name: p.high for p in geared.parameters}["velocity"]
    known = np.diag([1e-4] * 5)
    assert doubt(fit(geared, known, 0.1, 0.0, 0.05, 0.05, 0.3), scales()) == ""
    said = doubt(fit(geared, known, 0.1, 0.0, 0.05, 0.05, highest), scales())
    assert said.endswith("velocity is at the end of its range")


def test_a_number_at_the_end_of_its_range_is_not_named():
    _, high = bounds_of(COULOMB, scales())
    assert doubt(fit(COULOMB, 0.001, float(high[0])), scales()).endswith("torque is at the end of its range")
    assert doubt(fit(COULOMB, 0.001, 0.5 * float(high[0])), scales()) == ""
    low, high = bounds_of(GAIN, scales())
    for end in (low, high):
        assert doubt(fit(GAIN, 0.001, float(end[0])), scales()).endswith("gain is at the end of its range")


def test_static_friction_is_at_most_ten_times_the_largest_missing_torque():
    """The equations alone do not limit it: every error near standstill lies below a static friction that is large."""
    found = replace(scales(), missing=np.array([0.02, np.inf, np.inf]))
    stribeck = Location("stribeck_friction", "link", 0)
    assert scales().torque[0] > 0.02
    assert bounds_of(stribeck, found)[1].tolist()[:2] == [pytest.approx(0.2)] * 2
    assert doubt(fit(stribeck, 1e-4, 0.2, 0.02, 0.01), found).endswith("breakaway is at the end of its range")
    assert doubt(fit(stribeck, 1e-4, 0.05, 0.02, 0.01), found) == ""


def test_what_has_its_neutral_value_is_absent():
    assert doubt(fit(COULOMB, 0.0, 0.0), scales()) == "coulomb_friction at motor 1: is absent"
    assert doubt(fit(GAIN, 0.0, 1.0), scales()) == "torque_gain at motor 1: is absent"
    assert doubt(fit(GAIN, 0.01, 0.9), scales()) == ""
    assert doubt(fit(GAIN, 0.1, 0.9), scales()).endswith("consistent with zero")


def test_a_limit_is_absent_where_it_is_far_and_told_by_its_own_error():
    assert doubt(fit(LIMIT, 0.01, 0.5), scales()) == ""
    assert doubt(fit(LIMIT, 0.5, 0.5), scales()).endswith("consistent with zero")


def test_of_several_effects_each_must_be_plausible():
    one, other = fit(COULOMB, 0.001, 0.03), fit(GAIN, 0.1, 1.1)
    covariance = np.diag([0.001**2, 0.1**2])
    both = replace(one, effects=(*one.effects, *other.effects), covariance=covariance)
    assert doubt(both, scales()).startswith("torque_gain at motor 1")
    known = replace(both, covariance=np.diag([0.001**2, 0.01**2]))
    assert doubt(known, scales()) == ""


def test_a_richer_friction_whose_shape_is_at_its_end_is_the_plainer_one():
    """A Stribeck velocity of nearly nothing leaves Coulomb friction, with any breakaway torque beside it."""
    stribeck = Location("stribeck_friction", "link", 0)
    said = doubt(fit(stribeck, 1e-4, 0.06, 0.03, 1e-3), scales())
    assert said == "stribeck_friction at link: velocity is at the end of its range"
    assert doubt(fit(stribeck, 1e-4, 0.06, 0.03, 0.2), scales()) == ""


def test_friction_of_the_device_file_can_be_absent_but_not_less():
    location = Location("coulomb_friction", "link", 0)
    assert bounds_of(location, scales())[0].tolist() == [0.0]  # none is filed
    found = replace(scales(), friction=np.array([0.03, 0.0, 0.0]))
    assert bounds_of(location, found)[0].tolist() == [-0.03]
    assert doubt(fit(location, 1e-3, -0.03), found) == ""
    narrow = replace(found, missing=np.full(3, 0.002))
    assert doubt(fit(location, 1e-3, -0.02), narrow).endswith("end of its range")


def test_an_asymmetric_friction_whose_directions_agree_is_the_plainer_one():
    both = Location("asymmetric_coulomb", "link", 0)
    assert doubt(fit(both, 2e-3, 0.030, 0.034), scales()) == f"{both}: is consistent with coulomb_friction"
    assert doubt(fit(both, 2e-3, 0.030, 0.037), scales()) == ""
    common = 4e-4 * np.ones((2, 2)) + 1e-6 * np.eye(2)  # what is unknown of both is no difference
    assert doubt(fit(both, common, 0.060, 0.064), scales()) == ""


def test_on_a_subset_only_what_no_more_data_would_help_is_left_out():
    uncertain = fit(COULOMB, 0.01, 0.005)
    assert doubt(uncertain, scales()).endswith("consistent with zero") and absurd(uncertain, scales()) == ""
    _, high = bounds_of(COULOMB, scales())
    assert absurd(fit(COULOMB, 0.001, float(high[0])), scales()).endswith("torque is at the end of its range")
    assert absurd(fit(COULOMB, 0.0, 0.0), scales()).endswith("is absent")


def predicting(without: object, held: object, fitted: object = (), fitted_without: object = ()) -> bool:
    """Whether a model with the errors `held` and `fitted` may be named beside the errors without a model."""
    baseline = replace(evaluated(without), fitted=np.asarray(fitted_without, dtype=np.float64))
    model = replace(evaluated(held), fit=fit(COULOMB, 0.001, 0.01), fitted=np.asarray(fitted, dtype=np.float64))
    experiment = SimpleNamespace(may_veto=False, baseline=baseline, tuned=evaluated(without))
    return _supported(experiment, SimpleNamespace(scales=scales()))(model)


LEVEL = np.exp(0.01 * np.random.default_rng(1).normal(size=40))


@pytest.mark.parametrize(("left", "named"), [(30.0, True), (97.0, False), (100.0, False), (140.0, False)])
def test_only_what_is_clearly_better_than_no_model_is_named(left, named):
    """Against a prediction without a model that leaves 100 in every segment; within the margin is not better."""
    assert predicting(np.full(40, 100.0), left * LEVEL) == named


@pytest.mark.parametrize(("left", "named"), [(30.0, True), (100.0, False)])
def test_where_the_joint_rests_no_model_can_be_better_than_a_straight_line(left, named):
    """It rests in half of the segments, where the line is exact and the model slides by 20 times the noise."""
    rests = np.arange(40) % 2 == 0
    assert predicting(np.where(rests, 0.0, 100.0), np.where(rests, 400.0, left) * LEVEL) == named


def test_a_joint_that_always_rests_supports_no_model():
    assert not predicting(np.full(40, 0.5), np.full(40, 0.1))


@pytest.mark.parametrize(("left", "named"), [(30.0, True), (100.0, False)])
def test_fitted_segments_count_beside_few_held_out_ones(left, named):
    """One of four held-out segments is predicted badly, but not those that were fitted."""
    assert not predicting(np.full(4, 100.0), [50.0, 50.0, 50.0, 3000.0])
    assert predicting(np.full(4, 100.0), [50.0, 50.0, 50.0, 3000.0], left * LEVEL, np.full(40, 100.0)) == named


def test_a_ripple_has_a_whole_period_in_the_motion():
    """Otherwise it would be any function of the angle; the travel is that of its own axis."""
    travelled = replace(scales(), travel=np.array([9.0, 0.5, 4.0]))
    for motor, periods in ((1, 4.0 * np.pi), (2, 0.5 * np.pi)):
        low, high = bounds_of(Location("torque_ripple", "motor", motor), travelled)
        assert low[1] == pytest.approx(periods) and high[1] > 80.0
    eccentric = Location("encoder_eccentricity", "sensor", 1, ("order",))
    assert bounds_of(eccentric, travelled)[0][2] == min(p.low for p in eccentric.parameters if p.name == "order")


def test_a_ripple_that_asks_for_less_than_a_whole_period_is_not_named():
    """At the least order that a ripple may have, it stands for another function of the angle."""
    ripple = Location("torque_ripple", "motor", 1)
    least = float(bounds_of(ripple, scales())[0][1])
    sd = (0.001, 0.01, 0.01)
    assert doubt(fit(ripple, sd, 0.1, least, 0.3), scales()).endswith("order is at the end of its range")
    assert doubt(fit(ripple, sd, 0.1, 1.5 * least, 0.3), scales()) == ""
    more = Location("torque_ripple", "motor", 1, ("amplitude_2", "order_2", "phase_2"))
    for second, named in ((0.1, False), (0.0, True)):
        effect = more.effect(
            dict(zip((p.name for p in more.parameters), (0.1, 3.0 * least, 0.3, second, least, 0.1), strict=True))
        )
        both = Fit((effect,), np.zeros(2), 0.0, NOTHING, 1e-6 * np.eye(6))
        assert (doubt(both, scales()) == "") == named
