"""Damping from the dissipation torque: known truths, standard errors, standstill, and the least-squares baseline."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_core.weak_form import window_weights
from via_estimators import recursive_error
from via_estimators.damping_directional import DampingDirectional, DampingDirectionalParameters
from via_estimators.damping_rls import DampingRLS, DampingRLSParameters
from via_estimators.methods import estimator_for, methods_for
from via_estimators.rls import start, update

VPDA = load_device("compact_vpda")
QUANTUM = 2.0 * np.pi / 2**16
BOTH = [DampingDirectional, DampingRLS]


def moved(duration=6.0, torque_of=lambda v, t: 3.0 * v, noise=0.0, seed=0, quantum=0.0, jitter=0.0, rest=None):
    """Rows (N, 3) of time, angle, torque for the hand's velocity; `rest` (from, to) [s] stops time for the motion."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1e-3)
    t = t + jitter * 1e-3 * rng.uniform(-0.5, 0.5, len(t))
    s = t if rest is None else t - np.clip(t - rest[0], 0.0, rest[1] - rest[0])
    slow, fast = np.pi, 2.6 * np.pi
    q = -1.5 / slow * np.cos(slow * s) - 0.4 / fast * np.cos(fast * s + 1.0)
    v = 1.5 * np.sin(slow * s) + 0.4 * np.sin(fast * s + 1.0)
    if rest is not None:
        v = np.where((t >= rest[0]) & (t < rest[1]), 0.0, v)
    torque = torque_of(v, t) + noise * rng.normal(size=len(t))
    return np.column_stack([t, quantum * np.rint(q / quantum) if quantum else q, torque])


def with_terms(method, terms, **changes):
    estimator = method.from_device(VPDA)
    return estimator.with_parameters(replace(estimator.parameters, terms=terms, **changes))


@pytest.mark.parametrize("method", BOTH)
def test_constant_damping_is_recovered(method):
    estimates = with_terms(method, 1).run_rows(moved())[1]
    value = estimates.column("damping")[0][estimates.time > 1.0]
    np.testing.assert_allclose(value, 3.0, atol=5e-3)


def test_least_squares_with_forgetting_follow_a_late_jump():
    rows = moved(duration=20.0, torque_of=lambda v, t: np.where(t < 15.0, 1.0, 4.0) * v)
    estimates = with_terms(DampingRLS, 1, forgetting=0.99).run_rows(rows)[1]
    value = estimates.column("damping")[0]
    np.testing.assert_allclose(value[(estimates.time > 14.0) & (estimates.time < 15.0)], 1.0, atol=0.01)
    np.testing.assert_allclose(value[estimates.time > 16.0], 4.0, atol=0.04)


def test_cubic_damping_is_recovered_at_the_current_velocity():
    rows = moved(duration=20.0, torque_of=lambda v, _: 2.0 * v + 0.3 * v**3)
    estimator = with_terms(DampingDirectional, 2, velocity_scale=1.0, dry_friction=0.0)
    estimates = estimator.run_rows(rows)[1]
    middle = rows[:, 0] - 0.020
    v = 1.5 * np.sin(np.pi * middle) + 0.4 * np.sin(2.6 * np.pi * middle + 1.0)
    late = estimates.time > 5.0
    np.testing.assert_allclose(estimates.value[late, 0], (2.0 + 0.9 * v**2)[late], rtol=0.01)
    state, _ = estimator.run_rows(rows)
    np.testing.assert_allclose(estimator.coefficients(state)[:2], [2.0, 0.3], rtol=0.02)


def test_jittered_stamps_and_a_shifted_angle_have_no_significant_effect():
    estimator = with_terms(DampingDirectional, 1)
    rows = moved(jitter=0.8)
    value = estimator.run_rows(rows)[1].value
    np.testing.assert_allclose(value[1000:, 0], 3.0, rtol=2e-3)
    shifted = rows + np.array([0.0, 10.0, 0.0])
    np.testing.assert_allclose(estimator.run_rows(shifted)[1].value, value, rtol=1e-9)


def test_angle_and_torque_have_the_same_phase_unlike_a_filtered_difference():
    """A lag of 20 ms on the velocity alone causes an error of 10 %; here both signals have the same delay."""
    rows = moved()
    velocity, share = np.zeros(len(rows)), 1.0 - np.exp(-1e-3 / 0.02)
    for k in range(1, len(rows)):
        velocity[k] = velocity[k - 1] + share * ((rows[k, 1] - rows[k - 1, 1]) / 1e-3 - velocity[k - 1])
    naive = np.zeros(len(rows))
    P, w, gain = np.ones((1, 1)), np.zeros(1), np.zeros(1)
    for k in range(len(rows)):
        update(P, w, velocity[k : k + 1], rows[k, 2], 1.0, gain)
        P += 1e-3
        naive[k] = w[0]
    ours = with_terms(DampingDirectional, 1).run_rows(rows)[1].value[:, 0]
    assert np.abs(naive[1000:] / 3.0 - 1.0).max() > 0.2
    assert np.abs(ours[1000:] / 3.0 - 1.0).max() < 0.002


def test_a_jump_of_damping_is_followed_whereas_least_squares_return_the_mean():
    rows = moved(torque_of=lambda v, t: np.where(t < 3.3, 2.0, 4.0) * v)
    at = np.searchsorted(rows[:, 0], [3.2, 3.6])
    quick, slow = (with_terms(method, 1).run_rows(rows)[1].value[at, 0] for method in BOTH)
    np.testing.assert_allclose(quick, [2.0, 4.0], rtol=0.02)
    assert slow[0] == pytest.approx(2.0, rel=0.01) and slow[1] < 2.6


@pytest.mark.parametrize("varying", [False, True])
def test_reported_standard_deviations_match_empirical_ones(varying):
    """20 motions by hand with noise and encoder steps: reported over empirical scatter .8 to 1.25."""

    def damping(t):  # eq. (80), or constant
        swing = 1.4 * np.sin(0.05 * np.pi * t) ** 2 + 1.7 * np.sin(0.1 * np.pi * t) ** 2
        return 1.0 + swing if varying else np.full_like(t, 3.0)

    estimator, errors, sds = with_terms(DampingDirectional, 1), [], []
    for seed in range(20):
        rows = moved(14.0, lambda v, t: damping(t) * v, 0.05, seed, QUANTUM)
        estimates = estimator.run_rows(rows)[1]
        truth = damping(rows[:, 0])
        errors.append((estimates.value[:, 0] - truth)[6000:])  # by then friction is known to be none
        sds.append(estimates.standard_deviation[6000:, 0])
    error, sd = np.array(errors), np.array(sds)
    assert 0.8 <= np.sqrt(np.mean(sd**2) / np.mean(error**2)) <= 1.25
    assert np.mean(np.abs(error) <= 1.96 * sd) >= 0.9


def test_least_squares_report_their_standard_deviation():
    ratio = []
    for seed in range(30):
        estimates = with_terms(DampingRLS, 1).run_rows(moved(2.0, noise=0.05, seed=seed, quantum=QUANTUM))[1]
        ratio.append((estimates.value[-1, 0] - 3.0) / estimates.standard_deviation[-1, 0])
    assert 0.6 <= np.sqrt(np.mean(np.square(ratio))) <= 1.4


def test_dry_friction_appears_as_damping_unless_it_is_an_unknown():
    rows = moved(8.0, torque_of=lambda v, _: 3.0 * v + 0.1 * np.sign(v), noise=0.05, quantum=QUANTUM)
    for expected, bias in ((0.0, 0.13), (0.05, 0.0)):
        estimator = with_terms(DampingDirectional, 1, dry_friction=expected)
        state, estimates = estimator.run_rows(rows)
        value, sd = estimates.value[2000:, 0], estimates.standard_deviation[2000:, 0]
        assert np.mean(value) - 3.0 == pytest.approx(bias, abs=0.025)
        assert bool(np.mean(np.abs(value - 3.0) <= 1.96 * sd) > 0.7) is (expected > 0.0)
        friction = expected * estimator.coefficients(state)[-1]
        assert friction == pytest.approx(0.1 if expected else 0.0, abs=0.02)


def test_an_unknown_for_absent_friction_costs_little():
    rows = moved(8.0, noise=0.05, quantum=QUANTUM)
    errors = [
        np.abs(with_terms(DampingDirectional, 1, dry_friction=each).run_rows(rows)[1].value[2000:, 0] - 3.0).mean()
        for each in (0.0, 0.05)
    ]
    assert errors[1] < 1.5 * errors[0]


def test_an_unobservable_unknown_does_not_stop_the_others():
    """Without expected friction its column is zero and P becomes full there; the damping is still followed."""
    estimator = with_terms(DampingDirectional, 1, dry_friction=0.0, covariance_limit=0.2)
    rows = moved(12.0, torque_of=lambda v, t: np.where(t < 11.3, 2.0, 4.0) * v)
    estimates = estimator.run_rows(rows)[1]
    assert estimates.value[np.searchsorted(rows[:, 0], 11.6), 0] == pytest.approx(4.0, rel=0.03)


def test_six_seconds_of_rest_are_reported_and_forgotten_slowly():
    rows = moved(
        16.0, noise=0.05, quantum=QUANTUM, rest=(4.0, 10.0), torque_of=lambda v, t: np.where(t < 7.0, 3.0, 2.0) * v
    )
    for terms in (1, 2):
        estimator = with_terms(DampingDirectional, terms)
        estimates = estimator.run_rows(rows)[1]
        value, sd = estimates.value[:, 0], estimates.standard_deviation[:, 0]
        assert np.all(estimates.status[4050:9990] == Status.NOT_EXCITED)
        assert np.all(np.diff(sd[4060:9990]) >= 0.0)
        assert 0.5 < sd[9980] < VPDA.damping_of(1.0)  # damping may have changed meanwhile
        assert np.ptp(value[4060:9990]) == 0.0
        np.testing.assert_allclose(value[10_500:], 2.0, rtol=0.05)
        state = estimator.run_rows(rows[:9990])[0]
        P = estimator.covariance(state)
        assert np.linalg.eigvalsh(P)[0] > 0.0 and np.diag(P).max() <= estimator.parameters.covariance_limit


def test_after_a_long_rest_the_standard_deviation_is_at_most_the_prior_s():
    """Possible changes during the rest are included once, by the prior's variance, and not also as a lag."""
    t = np.arange(0.0, 38.0, 1e-3)
    fade = np.clip(np.maximum(4.0 - t, t - 34.0), 0.0, 1.0)
    v = fade**2 * (3.0 - 2.0 * fade) * (1.5 * np.sin(np.pi * t) + 0.4 * np.sin(2.6 * np.pi * t + 1.0))
    estimator, widest, missed = with_terms(DampingDirectional, 1), [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        q = QUANTUM * np.rint(1e-3 * np.cumsum(v) / QUANTUM)
        damping = np.where(t < 20.0, 3.0, 2.0)  # changed at rest, to make it worth the while
        estimates = estimator.run_rows(np.column_stack([t, q, damping * v + 0.05 * rng.normal(size=len(t))]))[1]
        value, sd = estimates.value[:, 0], estimates.standard_deviation[:, 0]
        widest.append(sd[10_000:].max())
        missed.append(np.abs(value - damping)[34_000:] / sd[34_000:])
    assert np.min(widest) / estimator.parameters.damping_deviation > 0.9
    assert np.max(widest) / estimator.parameters.damping_deviation < 1.02
    assert np.mean(np.array(missed) <= 1.96) >= 0.9


def test_alternating_motion_and_rest_keep_the_state_bounded():
    rows = moved(8.0, noise=0.05, quantum=QUANTUM, rest=(4.0, 6.0))
    for method in BOTH:
        estimator = with_terms(method, 3)
        state, estimates = estimator.run_rows(rows)
        size = state.size
        for turn in range(1, 20):
            later = rows + np.array([8.0 * turn, 0.0, 0.0])
            state, estimates = estimator.run_rows(later, state)
        assert state.size == size and np.isfinite(state).all()
        assert np.abs(estimates.value[1000:, 0] / 3.0 - 1.0).max() < 0.5
        assert np.isfinite(estimator.condition(state))


def test_velocities_never_visited_are_reported():
    growing = moved()
    growing[:, 1] = 0.5 * np.sin(6.0 * growing[:, 0]) * np.clip(growing[:, 0] / 3.0, 0.0, 1.0)
    estimates = with_terms(DampingDirectional, 2).run_rows(growing)[1]
    outside = estimates.status == Status.OUTSIDE_RANGE
    assert 0.05 < outside[200:3000].mean() < 0.8
    assert outside[4500:].mean() < 0.02


def test_recursive_least_squares_is_the_batch_solution_for_its_prior():
    rows = moved(noise=0.05)
    estimator = with_terms(DampingRLS, 2, dry_friction=0.0)
    _, estimates = estimator.run_rows(rows)
    length = estimator.parameters.window + 1
    velocity, torque = [], []
    for k in range(length - 1, len(rows)):
        own = rows[k - length + 1 : k + 1]
        weights = window_weights(5, own[:, 0])
        velocity.append(-weights[1] @ own[:, 1])
        torque.append(weights[0] @ own[:, 2])
    V = np.column_stack([velocity, np.array(velocity) ** 3 / 16.0])
    prior = np.array([estimator.parameters.damping_prior, 0.0])
    w = np.linalg.solve(V.T @ V + np.eye(2) / 10.0, V.T @ np.array(torque) + prior / 10.0)
    expected = w[0] + 3.0 * velocity[-1] ** 2 / 16.0 * w[1]
    assert estimates.value[-1, 0] == pytest.approx(expected, rel=1e-8)


def test_errata_73_the_stability_factor_is_only_a_different_prior():
    rows = moved(noise=0.05)
    free = {"covariance_limit": 1e9}
    stabilised = (
        with_terms(DampingRLS, 2, stability_factor=10.0, initial_covariance=1.0, **free).run_rows(rows)[1].value
    )
    plain = with_terms(DampingRLS, 2, initial_covariance=10.0, **free).run_rows(rows)[1].value
    np.testing.assert_allclose(stabilised, plain, rtol=1e-9)
    P, w, gain = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    start(P, w, 1.0)
    for _ in range(1000):  # poor excitation: one direction only
        update(P, w, np.array([1.0, 0.0]), 1.0, 0.1, gain)
    assert P[1, 1] == 1.0  # what no row visits is as unknown as before: no factor helps


def test_errata_70_p_has_one_row_per_unknown_and_not_per_sample():
    """P = (P(0)^-1 + V'V)^-1 is n x n; over samples, m x m as printed, (P(0)^-1 + VV')^-1 is another, worse matrix."""
    count, rows = 12, moved(0.052, noise=0.05)
    velocity = []
    for k in range(len(rows) - count, len(rows)):
        own = rows[k - 40 : k + 1]
        velocity.append(-window_weights(5, own[:, 0])[1] @ own[:, 1])
    V = np.column_stack([velocity, np.array(velocity) ** 3])
    right, printed = (np.linalg.inv(np.eye(len(square)) / 10.0 + square) for square in (V.T @ V, V @ V.T))
    given = {"velocity_scale": 1.0, "dry_friction": 0.0, "minimum_motion": 0.0}
    estimator = with_terms(DampingRLS, 2, **given)
    condition = estimator.condition(estimator.run_rows(rows)[0])
    assert condition == pytest.approx(np.sqrt(np.linalg.cond(right)), rel=1e-6)
    assert abs(condition / np.sqrt(np.linalg.cond(printed)) - 1.0) > 1e-3
    estimator = with_terms(DampingDirectional, 2, least_forgetting=1.0, correction=0.0, **given)
    P = estimator.covariance(estimator.run_rows(rows)[0])
    assert P.shape == (3, 3)  # the third unknown is friction
    np.testing.assert_allclose(P[:2, :2], right, rtol=1e-8)


def test_the_prior_s_error_is_not_counted_as_noise():
    """Prior off by 2.5 standard errors: innovations of the first rows are its error, not noise."""
    rows = moved(3.0, noise=0.05)
    off, on = (
        with_terms(DampingRLS, 1, damping_prior=prior, damping_deviation=2.0).run_rows(rows)[1] for prior in (8.0, 3.0)
    )
    np.testing.assert_allclose(off.standard_deviation[2000:], on.standard_deviation[2000:], rtol=0.3)


@pytest.mark.parametrize("declared", [0.02, 0.2])
def test_noise_is_measured_if_it_differs_from_the_declared_one(declared):
    rows = moved(4.0, noise=0.05)
    found, right = (
        with_terms(DampingRLS, 1, torque_noise=noise).run_rows(rows)[1].standard_deviation[-1, 0]
        for noise in (declared, 0.05)
    )
    assert found == pytest.approx(right, rel=0.25)


def test_the_error_recursion_is_the_covariance_of_the_estimate_as_a_function_of_raw_noise():
    """Brute force: the estimate is linear in every raw noise sample, so its covariance is J J'."""
    rng = np.random.default_rng(3)
    length, count, n = 6, 60, 2
    h = rng.uniform(0.5, 1.0, length)
    r = np.correlate(h, h, "full")[length - 1 :]
    J, P, w, gain = np.zeros((n, count + length)), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    start(P, w, 2.0)
    C, Q, G = np.zeros((n, n)), np.eye(n), np.zeros((n, length))
    transition, X, spare = np.eye(n), np.zeros(n), np.zeros(n)
    for k in range(count):
        v = rng.normal(size=n)
        raw = np.zeros(count + length)
        raw[k : k + length] = h
        innovation = raw - v @ J
        slot = k % length
        G[:, slot] = 0.0
        lagged = np.zeros(length)
        for d in range(length):
            lagged[(slot - d) % length] = r[d]
        variance = r[0] + recursive_error.expected(C, G, v, lagged, X)
        assert variance == pytest.approx(innovation @ innovation, rel=1e-9)
        update(P, w, v, 0.0, 1.0, gain)
        P /= 0.9
        J += np.outer(gain, innovation)
        transition = (np.eye(n) - np.outer(gain, v)) @ transition
        recursive_error.follow(C, Q, G, slot, gain, v, X, r[0], spare)
        np.testing.assert_allclose(C, J @ J.T, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(Q, transition @ transition.T, rtol=1e-8, atol=1e-12)


def test_only_damping_actuators_get_this_method():
    assert methods_for(VPDA) == ("damping_mixture", "damping_directional", "damping_rls")
    estimator = estimator_for(VPDA, "damping_directional")
    assert isinstance(estimator.inner, DampingDirectional)
    assert estimator.parameters.damping_prior == pytest.approx(2.55)
    assert estimator.parameters.damping_deviation == pytest.approx(3.1)
    assert estimator.parameters.torque_noise == 0.05 and estimator.parameters.dry_friction == 0.05
    assert estimator.inputs == ("q", "tau_link") and estimator.outputs == ("damping",)
    for method in BOTH:
        with pytest.raises(ParameterError, match="'maccepavd' is no rigid joint with a damper and a sensor"):
            method.from_device(load_device("maccepavd"))
    assert DampingDirectionalParameters().terms == DampingRLSParameters().terms == 1


def test_errata_78_79_without_any_torque_the_forgetting_factor_is_that_of_a_perfect_fit():
    """eta of (79) is 0 then and (78) is 0/0; with the lower bound, nothing is forgotten."""
    estimator = with_terms(DampingDirectional, 1, damping_prior=0.0)
    estimates = estimator.run_rows(moved(torque_of=lambda v, _: 0.0 * v))[1]
    assert np.all(estimates.value == 0.0)
    assert estimates.standard_deviation[-1, 0] < 0.015
