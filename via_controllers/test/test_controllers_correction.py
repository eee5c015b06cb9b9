"""Correction of a model parameter: closed forms, bounds under any estimates, and which estimates count."""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_controllers.correction import LONGEST, NOTHING, SILENCE, Correction, CorrectionRule
from via_core.errors import ParameterError
from via_core.status import Status

RULE = CorrectionRule(time=0.4, fallback_time=0.5, trusted_deviation=0.1, low=-0.5, high=2.0)
LAG, STEP = 0.2, 1e-4  # [s]


def course(state, seconds, estimate=None, rule=RULE, start=0.0, sd=0.0):
    """States after each step; `estimate` comes before each, if given."""
    states = [state]
    for k in range(1, round(seconds / STEP) + 1):
        time = start + k * STEP
        if estimate is not None:
            state = rule.informed(state, time, Status.OK, estimate, sd)
        state = rule.advanced(state, time, STEP)
        states.append(state)
    return states


def values(states):
    return np.array([each.value for each in states])


def two_lags(t, first, second):
    """What remains of a step after two lags in series, which begin together."""
    return (first * np.exp(-t / first) - second * np.exp(-t / second)) / (first - second)


def test_it_approaches_an_estimate_as_a_critically_damped_filter_of_mean_delay_T():
    x = values(course(Correction(), 6.0, 1.0))
    t = STEP * np.arange(len(x))
    assert x == pytest.approx(1.0 - (1.0 + t / LAG) * np.exp(-t / LAG), abs=2e-4)
    assert np.sum(1.0 - x) * STEP == pytest.approx(RULE.time, rel=1e-3)


def test_an_uncertain_estimate_has_less_weight():
    """S: half weight. 2 S: a fifth."""
    for share, weight in ((1.0, 0.5), (2.0, 0.2)):
        x = values(course(Correction(), 1.0, 1.0, sd=share * RULE.trusted_deviation))
        assert 1.0 - x == pytest.approx(two_lags(STEP * np.arange(len(x)), LAG / weight, LAG), abs=2e-4)


def test_without_estimates_it_returns_to_exactly_nothing():
    reached = course(Correction(), 8.0, 1.0)[-1]
    x = values(course(reached, 1.0, start=8.0 + SILENCE))
    assert x == pytest.approx(two_lags(STEP * np.arange(len(x)), RULE.fallback_time, LAG), abs=2e-4)
    ended = replace(reached, value=2.0 * NOTHING, wanted=2.0 * NOTHING)
    assert values(course(ended, 0.2, start=9.0))[-1] > 0.0
    assert course(ended, 1.0, start=9.0)[-1] == replace(reached, value=0.0, wanted=0.0)


def test_it_ends_with_both_lags():
    """An estimate that just came and is gone still moves x."""
    assert RULE.advanced(Correction(0.0, 1.0), 0.0, STEP).value > 0.0
    assert RULE.advanced(Correction(1.0, 0.0), 0.0, STEP).value > 0.9


def test_a_slow_correction_does_not_end_before_it_begins():
    slow = replace(RULE, time=1e7)
    assert 0.0 < course(Correction(), 0.003, 1.0, slow)[-1].wanted < NOTHING


@pytest.mark.parametrize("moving", [0.05, 0.3, 8.0], ids=["while it rises", "in the middle", "at the estimate"])
def test_its_rate_does_not_jump_when_estimates_end_or_return(moving):
    first = course(Correction(), moving, 1.0)
    gone = course(first[-1], 0.3 + SILENCE, start=moving)
    back = course(gone[-1], 0.3, 1.0, start=moving + 0.3 + SILENCE)
    rate = np.diff(np.concatenate([values(first), values(gone)[1:], values(back)[1:]])) / STEP
    most = (2.0 / LAG + 1.0 / RULE.fallback_time) / LAG  # of x'' for 0 <= y, e <= 1
    assert np.abs(np.diff(rate)).max() <= most * STEP


@given(
    st.lists(
        st.tuples(st.sampled_from(Status), st.floats(), st.floats(), st.floats(0.0, 0.3), st.booleans()), max_size=30
    )
)
@settings(deadline=None, max_examples=60, derandomize=True)
def test_no_estimates_move_it_beyond_its_bounds_or_faster(estimates):
    state, time, width = Correction(), 0.0, RULE.high - RULE.low
    for status, value, sd, step, sent in estimates:
        time += step
        if sent:
            state = RULE.informed(state, time, status, value, sd)
        after = RULE.advanced(state, time, step)
        low, high = RULE.low - 1e-12, RULE.high + 1e-12
        assert low <= after.value <= high and low <= after.wanted <= high
        assert abs(after.value - state.value) <= width * min(step, LONGEST) / LAG + 1e-12
        state = after


@pytest.mark.parametrize(("value", "kept"), [(1.0, 1.0), (9.0, 2.0), (-9.0, -0.5), (-0.25, -0.25)])
def test_an_estimate_is_clipped(value, kept):
    assert RULE.informed(Correction(), 1.0, Status.OK, value, 0.0) == Correction(0.0, 0.0, kept, 1.0, 1.0)


@pytest.mark.parametrize(
    ("status", "value", "sd"),
    [*((each, 1.0, 0.0) for each in Status if each != Status.OK), (Status.OK, nan, 0.0), (Status.OK, 1.0, nan),
     (Status.OK, inf, 0.0), (Status.OK, 1.0, inf), (Status.OK, 1.0, -1e-9)],
)  # fmt: skip
def test_what_is_not_a_good_estimate_ends_the_one_before(status, value, sd):
    used = Correction(0.3, 0.4, 0.5, 1.0, 2.0)
    assert RULE.informed(used, 2.5, status, value, sd) == replace(used, weight=0.0, stamp=2.5)


def test_an_estimate_older_than_the_last_one_is_ignored():
    used = Correction(0.3, 0.4, 0.5, 1.0, 2.0)
    for stamp in (1.9, -inf, inf, nan):
        assert RULE.informed(used, stamp, Status.OK, 1.0, 0.0) is used
    assert RULE.informed(used, 2.0, Status.OK, 1.0, 0.0).estimate == 1.0


@pytest.mark.parametrize(("age", "used"), [(0.0, True), (0.09, True), (0.11, False), (-0.09, True), (-0.11, False)])
def test_an_estimate_is_used_for_a_tenth_of_a_second(age, used):
    at_rest = Correction(0.0, 0.0, 1.0, 1.0, 5.0)
    assert (RULE.advanced(at_rest, 5.0 + age, STEP).wanted > 0.0) is used


def test_a_long_gap_counts_as_a_tenth_of_a_second():
    used = Correction(0.0, 0.0, 1.0, 1.0, 5.0)
    assert RULE.advanced(used, 5.0, 60.0) == RULE.advanced(used, 5.0, 0.1)
    assert RULE.advanced(used, 5.0, 0.1).wanted == pytest.approx(1.0 - exp(-0.1 / LAG))


def test_without_any_estimate_nothing_is_corrected():
    assert RULE.advanced(Correction(), 0.0, 0.1) == Correction(0.0, 0.0, 0.0, 0.0, -inf)


@pytest.mark.parametrize(
    "change",
    [{"time": 0.0}, {"fallback_time": -1.0}, {"trusted_deviation": 0.0}, {"low": 0.1}, {"high": -0.1}],
)
def test_invalid_rules_are_refused(change):
    with pytest.raises(ParameterError):
        replace(RULE, **change)
    assert replace(RULE, low=0.0).low == replace(RULE, high=0.0).high == 0.0
