"""Kinematic Kalman filters against the textbook matrices, numerical truncation, and simulated encoders."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import truncnorm
from via_estimators import kinematic_kalman as kalman

QUANTUM = 2.0 * np.pi / 2**14


def filtered(angles, interval, acceleration, noise, quantum=0.0, fastest=10.0):
    """States (N, 2) and covariances (N, 3) of a whole record; quantum 0: the plain filter."""
    parameters = SimpleNamespace(acceleration=acceleration, quantum=quantum, position_noise=noise)
    par, bank, out = kalman.parameter_row(parameters), np.empty((1, kalman.F.size)), []
    kalman.start(bank[0], angles[0], noise**2 + quantum**2 / 12.0, fastest)
    for k, angle in enumerate(angles):
        if k:
            kalman.follow(par, bank, np.array([k * interval, angle]), interval, False)
        out.append(bank[0, :5].copy())
    return np.array(out)[:, :2], np.array(out)[:, 2:]


def wandering(seed, count=4000, interval=1e-3, acceleration=20.0):
    """Angle (N,) and velocity (N,) of exactly the filter's model (53), slow enough for changes by single quanta."""
    rng = np.random.default_rng(seed)
    x, v = np.zeros(count), np.zeros(count)
    for k in range(1, count):
        a = acceleration * rng.normal() - 2.0 * v[k - 1]
        x[k] = x[k - 1] + interval * v[k - 1] + 0.5 * interval**2 * a
        v[k] = v[k - 1] + interval * a
    return x, v


def test_the_plain_filter_is_the_textbook_one():
    """Eqs. (53), (54) with matrices."""
    rng = np.random.default_rng(3)
    z, T, V, R = np.cumsum(rng.normal(size=200)) * 1e-3, 2e-3, 30.0**2, 1e-6
    states, covariances = filtered(z, T, 30.0, 1e-3, fastest=5.0)
    F, G, H = np.array([[1.0, T], [0.0, 1.0]]), np.array([T * T / 2.0, T]), np.array([1.0, 0.0])
    x, P = np.array([z[0], 0.0]), np.diag([R, 25.0])
    for k in range(1, len(z)):
        x, P = F @ x, F @ P @ F.T + V * np.outer(G, G)
        K = P @ H / (H @ P @ H + R)
        x, P = x + K * (z[k] - x[0]), P - np.outer(K, H @ P)
        np.testing.assert_allclose(states[k], x, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(covariances[k], [P[0, 0], P[0, 1], P[1, 1]], rtol=1e-8)


@pytest.mark.parametrize("away", [-0.7, -0.6, -0.2, 0.0, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("width", [0.05, 0.3, 1.0, 20.0])
def test_a_quantised_measurement_truncates_the_prediction_to_its_interval(away, width):
    """Moments of the truncated Gaussian by scipy; velocity follows by its regression on the angle."""
    state = np.array([0.2, -0.5, (width * QUANTUM) ** 2, 0.3 * width * QUANTUM, 0.7, 9.0])
    before, z = state.copy(), 0.2 + away * QUANTUM
    kalman.correct_quantised(state, z, QUANTUM, 0.0)
    s = np.sqrt(before[2])
    cut = truncnorm((z - QUANTUM / 2 - 0.2) / s, (z + QUANTUM / 2 - 0.2) / s, 0.2, s)
    assert state[0] == pytest.approx(cut.mean(), abs=1e-7 * QUANTUM)
    assert state[2] == pytest.approx(cut.var(), rel=1e-5)
    slope = before[3] / before[2]
    assert state[1] == pytest.approx(-0.5 + slope * (cut.mean() - 0.2), rel=1e-6)
    assert state[4] == pytest.approx(0.7 - slope**2 * (before[2] - cut.var()), rel=1e-6)


def test_a_quantised_measurement_has_no_information_inside_its_interval_and_d_square_over_12_for_a_flat_prior():
    sure = np.array([1.0, 0.0, (1e-3 * QUANTUM) ** 2, 0.0, 1.0, 9.0])
    kalman.correct_quantised(sure, 1.0 + 0.2 * QUANTUM, QUANTUM, 0.0)
    np.testing.assert_allclose(sure[[0, 2]], [1.0, (1e-3 * QUANTUM) ** 2], rtol=1e-12)
    lost = np.array([1.0, 0.0, (300.0 * QUANTUM) ** 2, 0.0, 1.0, 9.0])
    kalman.correct_quantised(lost, 1.0 + 5.0 * QUANTUM, QUANTUM, 0.0)
    assert lost[0] == pytest.approx(1.0 + 5.0 * QUANTUM, abs=1e-3 * QUANTUM)
    assert lost[2] == pytest.approx(QUANTUM**2 / 12.0, rel=1e-3)


def test_a_wrong_prediction_recovers():
    state = np.array([0.0, 0.0, (0.01 * QUANTUM) ** 2, 0.0, 1.0, 9.0])
    for _ in range(200):
        kalman.predict(state, 1e-3, 20.0**2)
        kalman.correct_quantised(state, 40.0 * QUANTUM, QUANTUM, 0.0)
    assert np.isfinite(state).all() and abs(state[0] - 40.0 * QUANTUM) < QUANTUM


@pytest.mark.parametrize(("acceleration", "too_much"), [(0.3, 0.4), (3.0, 0.8)])
def test_modified_filter_is_consistent_and_the_plain_one_overconfident(acceleration, too_much):
    """Motion of a hundredth and a tenth of a quantum per sample: equal measurements are not independent."""
    ratio, error = {}, {}
    for name, noise, quantum in (("modified", 1e-7, QUANTUM), ("plain", QUANTUM / np.sqrt(12.0), 0.0)):
        squares, promised = [], []
        for seed in range(50):
            x, _ = wandering(seed, 2000, acceleration=acceleration)
            reading = QUANTUM * np.round(x / QUANTUM)
            states, covariances = filtered(reading, 1e-3, acceleration, noise, quantum, fastest=0.1)
            squares.append((states[500:, 0] - x[500:]) ** 2)
            promised.append(covariances[500:, 0])
        error[name] = np.sqrt(np.mean(squares))
        ratio[name] = np.sqrt(np.mean(promised)) / error[name]
    assert 0.85 <= ratio["modified"] <= 1.15
    assert ratio["plain"] < too_much
    assert error["modified"] < 0.27 * QUANTUM


def test_a_repeated_measurement_contains_no_information():
    state = np.zeros(kalman.F.size)
    kalman.start(state, 0.0, QUANTUM**2 / 12.0, 0.1)
    kalman.correct_quantised(state, QUANTUM, QUANTUM, 0.0)
    once = state.copy()
    kalman.correct_quantised(state, QUANTUM, QUANTUM, 0.0)
    assert np.array_equal(state, once)


def test_covariance_stays_bounded_at_standstill():
    states, covariances = filtered(np.zeros(20_000), 1e-3, 20.0, 0.0, QUANTUM)
    assert np.abs(states[-1]).max() < 1e-9
    assert covariances[-1, 0] < QUANTUM**2 / 12.0
    np.testing.assert_allclose(covariances[-1], covariances[10_000], rtol=1e-9)
