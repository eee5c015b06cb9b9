"""Kalman filters of several servos against a slow, obvious version, and the weights that they get."""

import numpy as np
import pytest
from via_core.servos import servo_step
from via_estimators import servo_models as models
from via_estimators.servo_models import FILTER, MOTION, SERVO, Servos

N, OWN = 3, 1
MEMORY, PERSISTENCE = np.array([5.0, 100.0, 100.0]), 20.0
VARIANCES = np.array([0.02, 0.01, 2.5])  # within, beside, overlap
WIDTH, MIDDLE = 0.7, 1.0


def begun(table):
    state = np.empty(models.size(len(table), N))
    models.start(state, table, N)
    return state


def equations(count, truth, which, seed=3, noise=0.1):
    """Rows of one equation each: time, row, what every model multiplies with its own unknown, y."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        row, each = rng.normal(size=N), rng.normal(size=4)
        full = row.copy()
        full[OWN] = WIDTH * each[which]
        yield 0.025 * k, row, each, full @ truth + MIDDLE * each[which] + noise * rng.normal()


def take(state, table, time, row, each, y):
    models.take(
        state, table, time, MEMORY, PERSISTENCE, row.copy(), OWN, each, WIDTH, MIDDLE, y, VARIANCES, np.empty(N)
    )


def slow(table, rows):
    """The same with matrices, one model at a time; mean, covariance and weights."""
    within, beside, overlap = VARIANCES
    found, last = [], None
    for j in range(len(table)):
        x, P, likelihood, noise, equations, last = np.zeros(N), np.eye(N), 0.0, 1.0, 1.0, None
        for time, row, each, y in rows:
            elapsed = 0.0 if last is None else time - last
            last = time
            h = row.copy()
            h[OWN] = WIDTH * each[j]
            K = np.diag(np.exp(-elapsed / MEMORY))
            P = K @ P @ K + np.eye(N) - K @ K
            v = y - MIDDLE * each[j] - h @ x
            error = noise * within + beside
            S = h @ P @ h + error
            stay = np.exp(-elapsed / PERSISTENCE)
            likelihood = stay * likelihood - (np.log(S / within) + v**2 / S) / (2.0 * overlap)
            share = (error / S) ** 2 / overlap
            equations = 1.0 + stay * (equations - 1.0) + share
            noise = max(noise + (v**2 - S) / within * share / equations, 1e-8)
            gain = P @ h / (h @ P @ h + overlap * error)
            x, P = x + gain * v, P - np.outer(gain, P @ h)
        found.append((x, P, likelihood + table[j, SERVO.log_prior]))
    weights = np.exp([each[2] - max(other[2] for other in found) for each in found])
    weights /= weights.sum()
    mean = sum(w * each[0] for w, each in zip(weights, found, strict=True))
    each_square = [each[1] + np.outer(each[0] - mean, each[0] - mean) for each in found]
    return mean, sum(w * each for w, each in zip(weights, each_square, strict=True)), weights


def test_it_equals_the_slow_version():
    table = Servos(lags=((1.0, 0.0), (0.6, 0.0)), speeds=(0.5, 1.0)).around(25.0, 0.045, 6.5)
    rows = list(equations(60, np.array([0.5, -0.3, 0.8]), 2, noise=0.3))
    state = begun(table)
    for each in rows:
        take(state, table, *each)
    mean, covariance = models.estimate_of(state, N)
    expected = slow(table, rows)
    np.testing.assert_allclose(mean, expected[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(covariance, expected[1], rtol=1e-9, atol=1e-12)
    weights = models.filters_of(state, len(table), N)[:, FILTER.weight]
    np.testing.assert_allclose(weights, expected[2], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("which", range(4))
def test_the_servo_that_made_the_data_is_found(which):
    table = Servos(lags=((1.0, 0.0), (0.6, 0.0)), speeds=(0.5, 1.0)).around(25.0, 0.045, 6.5)
    truth, state = np.array([0.5, -0.3, 0.8]), begun(table)
    for each in equations(150, truth, which):
        take(state, table, *each)
    assert models.filters_of(state, 4, N)[which, FILTER.weight] > 0.95
    mean, covariance = models.estimate_of(state, N)
    assert np.all(np.abs(mean - truth) < 4.0 * np.sqrt(np.diag(covariance)) + 0.02)


def test_equal_servos_keep_their_prior_weights_and_the_covariance_forgets():
    table = Servos(lags=((1.0, 0.0), (0.6, 0.0)), speeds=(0.5, 1.0)).around(25.0, 0.045, 6.5)
    state = begun(table)
    for time, row, each, y in equations(40, np.zeros(N), 0):
        take(state, table, time, row, np.full(4, each[0]), y)
    weights = models.filters_of(state, 4, N)[:, FILTER.weight]
    np.testing.assert_allclose(weights, np.exp(table[:, SERVO.log_prior]), rtol=1e-9)
    P = models.estimate_of(state, N)[1].copy()
    models.forget(P, 1e6, MEMORY)
    np.testing.assert_allclose(P, np.eye(N), atol=1e-12)


def test_the_table_surrounds_the_file_and_an_unknown_speed_limit_prefers_none():
    table = Servos().around(25.0, 0.045, 6.5)
    assert np.exp(table[:, SERVO.log_prior]).sum() == pytest.approx(1.0)
    assert np.all(np.diff(table[:, SERVO.dead_time]) >= 0.0) and table[:, SERVO.dead_time].min() >= 0.0
    best = table[np.argmax(table[:, SERVO.log_prior])]
    np.testing.assert_allclose(best[:3], (25.0, 0.045, 6.5))
    unknown = Servos().around(25.0, 0.045, 0.0)
    by_speed = [unknown[unknown[:, SERVO.speed_limit] == s, SERVO.log_prior] for s in np.unique(unknown[:, 2])]
    assert len(by_speed) == 5 and np.ptp([np.exp(each).sum() for each in by_speed]) < 1e-12


def test_a_servo_follows_its_command_within_its_speed_and_stays_without_one():
    free, slow_servo = np.array([25.0, 0.0, 1e9, 0.0]), np.array([25.0, 0.0, 2.0, 0.0])
    motion, limited = np.zeros(MOTION.size), np.zeros(MOTION.size)
    x = v = 0.0
    for _ in range(20):
        x, v = servo_step(x, v, 1.0, 25.0, 5e-3)
        models.follow(motion, free, 1.0, np.nan, 5e-3)
        models.follow(limited, slow_servo, 1.0, 0.5, 5e-3)
    assert motion[MOTION.angle] == pytest.approx(x, rel=1e-12) and motion[MOTION.preset] == 0.0
    assert limited[MOTION.angle] <= 2.0 * 0.1 + 1e-12 and 0.0 < limited[MOTION.preset] <= 0.2 + 1e-12
