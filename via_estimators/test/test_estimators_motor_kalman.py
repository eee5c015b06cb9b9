"""Extended and unscented Kalman filters: slow obvious versions, filterpy, honest statistics, planted truths."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, KalmanFilter, UnscentedKalmanFilter
from scipy.stats import chi2
from via_core.devices import load_device
from via_core.status import Status
from via_estimators import extended_kalman, motor_kalman, motor_model, unscented_kalman
from via_estimators.extended_kalman import ExtendedKalman, ExtendedKalmanParameters
from via_estimators.unscented_kalman import UnscentedKalman, UnscentedKalmanParameters

BOTH = pytest.mark.parametrize(
    "kind", [ExtendedKalman, UnscentedKalman], ids=["extended_kalman", "unscented_kalman"]
)  # fmt: skip
PARAMETERS = {ExtendedKalman: ExtendedKalmanParameters, UnscentedKalman: UnscentedKalmanParameters}
PREDICT = {ExtendedKalman: extended_kalman.predict, UnscentedKalman: unscented_kalman.predict}
MODEL = np.array([1.0, 1.0, 0.02, 0.05])  # order, deflection scale, B_0, v_s
LINEAR = np.array([0.1, 0.2, 1.0, 0.3, 0.0, 20.0])  # no dry friction, a linear spring


def inputs(count=300, seed=0):
    """Time steps (count, 4) INPUT at irregular stamps, and measured angles (count,)."""
    rng = np.random.default_rng(seed)
    T = 1e-3 * rng.uniform(0.3, 2.0, count)
    q = 0.3 * np.sin(np.cumsum(T) * 20.0)
    return np.column_stack([T, np.append(0.0, q[:-1]), q, rng.normal(size=count)]), 0.1 + 0.05 * rng.normal(size=count)


def linear_map(given):
    """F (2, 2) and the constant (2,) of a step: the model is linear in angle and velocity with known parameters."""

    def moved(angle, velocity):
        x = np.array([angle, velocity, *LINEAR[2:]])
        return np.array(motor_model.advance(MODEL, x, given, np.empty((4, 6))))

    constant = moved(0.0, 0.0)
    return np.column_stack([moved(1.0, 0.0) - constant, moved(0.0, 1.0) - constant]), constant


@BOTH
def test_with_known_parameters_and_a_linear_spring_it_is_the_kalman_filter_of_filterpy(kind):
    steps, measured = inputs()
    x, P, work, points = LINEAR.copy(), np.zeros((6, 6)), np.empty((4, 6)), np.empty((11, 6))
    P[0, 0], P[1, 1] = 1e-4, 4.0
    known = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    known.x, known.P, known.H, known.R = x[:2].reshape(2, 1).copy(), P[:2, :2].copy(), np.eye(1, 2), np.array([[1e-6]])
    for given, z in zip(steps, measured, strict=True):
        F, constant = linear_map(given)
        variance = motor_model.noise(MODEL, x, P, given, 0.05, 1e-3, work)
        assert variance == pytest.approx((0.05**2 + (20.0 * 1e-3) ** 2) / 0.02**2, rel=1e-9)
        factors = np.empty(6)
        motor_model.factors(0.3 / 0.02, given[0], factors)
        G = factors[[2, 1]].reshape(2, 1)
        known.predict(u=np.ones((1, 1)), B=constant.reshape(2, 1), F=F, Q=variance * G @ G.T)
        known.update(z)
        PREDICT[kind](MODEL, x, P, given, work, points[: 4 if kind is ExtendedKalman else 11])
        motor_model.add_noise(MODEL, x, given[0], variance, work, P)
        motor_kalman.correct(x, P, z, 1e-6, points[0])
        np.testing.assert_allclose(x[:2], known.x[:, 0], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(P[:2, :2], known.P, rtol=1e-7, atol=1e-14)
    assert not P[2:].any()


def correlated(n, seed=1):
    """A state with dry friction and a cubic spring, and its correlated covariance (n, n)."""
    rng = np.random.default_rng(seed)
    x = np.array([0.1, 0.2, 1.0, 0.3, 0.1, *rng.uniform(5.0, 20.0, n - 5)])
    root = rng.normal(size=(n, n)) * np.array([0.01, 0.3, 0.1, 0.05, 0.05, *np.full(n - 5, 3.0)])[:, None]
    return x, root @ root.T


def test_the_correction_equals_the_textbook():
    x, P = correlated(7)
    H, R, z = np.eye(1, 7), 1e-5, 0.13
    K = P @ H.T / (H @ P @ H.T + R)
    expected = x + K[:, 0] * (z - x[0]), (np.eye(7) - K @ H) @ P
    motor_kalman.correct(x, P, z, R, np.empty(7))
    np.testing.assert_allclose(x, expected[0], rtol=1e-12)
    np.testing.assert_allclose(P, expected[1], rtol=1e-9, atol=1e-12)
    assert np.array_equal(P, P.T)


def test_the_extended_prediction_equals_its_matrices():
    model, given = np.array([2.0, 1.0, 0.02, 0.05]), np.array([1e-3, 0.4, 0.41, 0.7])
    x, P = correlated(7)
    F = np.eye(7)
    motor_model.derivatives(model, x, given, np.empty((4, 7)), F[:2])
    expected = F @ P @ F.T
    extended_kalman.predict(model, x, P, given, np.empty((4, 7)), np.empty((4, 7)))
    np.testing.assert_allclose(P, expected, rtol=1e-10, atol=1e-14)


def test_the_unscented_prediction_is_that_of_filterpy():
    model, given = np.array([2.0, 1.0, 0.02, 0.05]), np.array([1e-3, 0.4, 0.41, 0.7])
    x, P = correlated(7)

    def moved(point, dt):
        return np.array([*motor_model.advance(model, point, given, np.empty((4, 7))), *point[2:]])

    points = JulierSigmaPoints(7, kappa=0.0)
    other = UnscentedKalmanFilter(7, 1, 1e-3, None, moved, points)
    other.x, other.P, other.Q = x.copy(), P.copy(), np.zeros((7, 7))
    other.predict()
    unscented_kalman.predict(model, x, P, given, np.empty((4, 7)), np.empty((12, 7)))
    np.testing.assert_allclose(x, other.x, rtol=1e-10)
    np.testing.assert_allclose(P, other.P, rtol=1e-8, atol=1e-12)


def test_the_root_of_a_singular_covariance_has_zero_columns():
    v, L = np.array([1.0, 2.0, 3.0]), np.empty((3, 3))
    unscented_kalman.root_of(np.outer(v, v), L)
    np.testing.assert_allclose(L, np.column_stack([v, np.zeros(3), np.zeros(3)]), atol=1e-12)


@BOTH
def test_errors_have_the_size_that_the_covariance_states(kind):
    """NEES of angle, velocity and an unknown stiffness that is drawn from its prior; noise as declared."""
    sizes = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        steps, _ = inputs(400, seed)
        truth, x, P = LINEAR.copy(), LINEAR.copy(), np.zeros((6, 6))
        P[0, 0], P[1, 1], P[5, 5] = 1e-8, 0.01, 9.0
        truth[[0, 1, 5]] += np.sqrt(np.diag(P)[[0, 1, 5]]) * rng.normal(size=3)
        work, points = np.empty((4, 6)), np.empty((11, 6))
        for given in steps:
            disturbed = given + np.array([0.0, 0.0, 0.0, 0.05 * rng.normal()])
            truth[:2] = motor_model.advance(MODEL, truth, disturbed, work)
            variance = motor_model.noise(MODEL, x, P, given, 0.05, 1e-4, work)
            PREDICT[kind](MODEL, x, P, given, work, points[: 4 if kind is ExtendedKalman else 11])
            motor_model.add_noise(MODEL, x, given[0], variance, work, P)
            motor_kalman.correct(x, P, truth[0] + 1e-4 * rng.normal(), 1e-8, points[0])
        error, known = (x - truth)[[0, 1, 5]], P[np.ix_([0, 1, 5], [0, 1, 5])]
        sizes.append(error @ np.linalg.solve(known, error))
    assert np.sqrt(known[2, 2]) < 1.0  # the stiffness has been learned: 3 N m/rad before
    low, high = chi2.ppf([0.005, 0.995], 3 * 60) / 60
    assert low < np.mean(sizes) < high


def planted(count=4000, jitter=0.8, inertia=0.02, damping=0.3, friction=0.05, spring=(8.0, 5.0), noise=0.01, seed=0):
    """Rows (count, 4) of one motor in prescribed motion with its torque, and the true stiffness."""
    rng = np.random.default_rng(seed)
    t = 1e-3 * (np.arange(count) + jitter * rng.uniform(-0.5, 0.5, count))

    def motion(t):
        theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
        rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
        bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
        phi = 0.5 * np.sin(4.0 * t) - theta
        torque = inertia * bend + damping * rate + friction * np.sign(rate) - spring[0] * phi - spring[1] * phi**3
        return theta, phi, torque

    theta, phi, _ = motion(t)
    step = np.diff(t, prepend=t[0] - 1e-3)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5 * step * (x - 1.0))[2] for x, w in zip(nodes, weights, strict=True))
    rows = np.column_stack([t, phi + theta, theta, effort + noise * rng.normal(size=count)])
    rows[:, 1:3] = np.round(rows[:, 1:3] / 1e-4) * 1e-4
    return rows, spring[0] + 3.0 * spring[1] * phi**2


def planted_filter(kind, **changed):
    own = {"transmissions": 1, "order": 2, "truncation": 0.0, "torque_noise": 0.01, "position_noise": 1e-4 / 12**0.5}
    return kind(PARAMETERS[kind](**{**own, "inertia_prior": 0.025, "inertia_deviation": 0.008, **changed}))


@BOTH
@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_a_planted_truth_is_recovered_at_irregular_stamps_and_with_lost_samples(kind, lost):
    rows, truth = planted()
    kept = np.random.default_rng(1).random(len(rows)) >= lost
    rows, truth = rows[kept], truth[kept]
    _, found = planted_filter(kind).run_rows(rows)
    later = rows[:, 0] > 2.0
    assert (found.status[later] == Status.OK).mean() > 0.7
    error = found.value[:, 0] - truth
    assert np.sqrt(np.mean(error[later] ** 2)) < 0.02 * np.sqrt(np.mean(truth**2))
    assert found.column("motor_inertia_1")[0][-1] == pytest.approx(0.02, rel=0.05)
    assert found.column("motor_damping_1")[0][-1] == pytest.approx(0.3, rel=0.05)
    if not lost:
        assert np.mean(np.abs(error[later]) <= 1.96 * found.standard_deviation[later, 0]) > 0.8


@BOTH
def test_a_motor_of_very_fast_damping_is_no_obstacle(kind):
    """D/B = 12700 1/s at 1 kHz, the motor of cubic_aa_vsa."""
    rows, truth = planted(inertia=1e-4, damping=1.27, friction=0.0, spring=(0.0, 10.0))
    device = load_device("cubic_aa_vsa")
    own = replace(
        kind.from_device(device).parameters, transmissions=1, torque_noise=0.01, position_noise=1e-4 / 12**0.5
    )
    _, found = kind(own).run_rows(rows)
    later = rows[:, 0] > 2.0
    assert np.sqrt(np.mean((found.value[:, 0] - truth)[later] ** 2)) < 0.03 * np.sqrt(np.mean(truth**2))
    assert found.column("motor_damping_1")[0][-1] == pytest.approx(1.27, rel=0.02)


@BOTH
def test_a_filter_that_diverges_starts_anew(kind):
    rows, _ = planted(1000)
    estimator = planted_filter(kind)
    state, _ = estimator.run_rows(rows[:900])
    broken = state.copy()
    part = motor_kalman.views(estimator._constants, broken)[3][0]
    motor_kalman.filter_of(part, estimator.size)[1][3] = np.inf
    later, estimate = estimator.step(broken, rows[900])
    assert estimate.status == Status.WARMING_UP and np.isfinite(estimate.value).all()
    later, _ = estimator.step(later, rows[901])
    _, x, covariance = motor_kalman.filter_of(motor_kalman.views(estimator._constants, later)[3][0], 7)
    assert np.isfinite(covariance).all() and x[0] == rows[901, 2]  # at the measured angle
