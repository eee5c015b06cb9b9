"""Moving-horizon estimation: derivatives, batch least squares, the Kalman filter, planted truths, standard errors."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from test_estimators_unknown_input_observer import DAMPING, INERTIA, planted
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators import horizon_problem as problem
from via_estimators import horizon_samples
from via_estimators.horizon_problem import DATA, Model
from via_estimators.moving_horizon import MovingHorizon, MovingHorizonParameters

PLAIN = MovingHorizonParameters(
    transmissions=1, order=2, truncation=0.0, drift=0.0, torque_noise=0.01, position_noise=1e-5, inertia_prior=0.03,
    damping_prior=0.2, stiffness_deviation=30.0, stiffness_prior=5.0, friction_deviation=0.3,
)  # fmt: skip
MODEL = Model(2, 3, 0.8, 0.1, np.array([0.02, 0.3, 0.1, 8.0, 1.0, 0.2, 3.0, -2.0]), np.linspace(0.5, 1.5, 8))
SURE = Model(1, 0, 1.0, 0.1, np.array([INERTIA, DAMPING, 0.0, 8.0]), np.array([1e-9, 1e-9, 1e-9, 1e-9]))
POSITION_NOISE = PLAIN.position_noise
COUNT, SPAN = 24, 0.01  # intervals, [s]


def intervals(count, seed):
    """Data (count, DATA.size) of intervals with random signals; unequal spans."""
    rng = np.random.default_rng(seed)
    data = rng.normal(size=(count, DATA.size))
    data[:, DATA.span] = SPAN * rng.uniform(0.5, 1.5, count)
    data[:, DATA.impulse] *= SPAN
    data[:, DATA.moment] *= 0.1 * SPAN**2
    data[:, DATA.sd_impulse], data[:, DATA.sd_moment], data[:, DATA.sd_theta] = 1e-3, 5e-6, 0.02
    return data


def test_jacobian_equals_finite_differences():
    rng = np.random.default_rng(0)
    data, nodes, z = intervals(5, 1), rng.normal(size=(6, 2)), 0.2 * rng.normal(size=8)
    data[:, DATA.sd_impulse :] = 1.0
    _, jacobian = problem.linearise(MODEL, nodes, z, data)
    step = 1e-6
    for at in range(2 * 6 + 8):
        moved = np.concatenate([nodes.ravel(), z])
        ends = []
        for sign in (1.0, -1.0):
            each = moved.copy()
            each[at] += sign * step
            ends.append(problem.linearise(MODEL, each[:12].reshape(6, 2), each[12:], data)[0])
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        for k in range(5):
            local = at - 2 * k if at < 12 else at - 8
            expected = jacobian[k, :, local] if at >= 12 or 0 <= local < 4 else 0.0
            np.testing.assert_allclose(numeric[k], expected, atol=1e-6)


def linear_rows(data):
    """Equations rows x = right of all nodes (2 (M + 1),) for the model SURE, written out independently."""
    B, D, K = INERTIA, DAMPING, 8.0
    count = len(data)
    rows, right = np.zeros((3 * count, 2 * count + 2)), np.zeros(3 * count)
    for k, d in enumerate(data):
        T = d[DATA.span]
        middle = np.array([0.5, T / 8.0, 0.5, -T / 8.0])  # theta in the middle, of theta and omega at both ends
        mean = np.array([0.5, T / 12.0, 0.5, -T / 12.0])
        first, last = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
        simpson = T / 6.0 * (first + 4.0 * middle + last)
        pull = T / 6.0 * K * (d[DATA.q_start] + 4.0 * d[DATA.q_middle] + d[DATA.q_end])
        impulse = np.array([-D, -B, D, B]) + K * simpson
        moment = np.array([-B, -B * T / 2.0 + D * T * T / 12.0, B, -B * T / 2.0 - D * T * T / 12.0])
        moment += T * T / 12.0 * K * (first - last)
        at = slice(2 * k, 2 * k + 4)
        rows[3 * k, at], right[3 * k] = impulse / d[DATA.sd_impulse], (d[DATA.impulse] + pull) / d[DATA.sd_impulse]
        turned = T * T / 12.0 * K * (d[DATA.q_start] - d[DATA.q_end])
        rows[3 * k + 1, at], right[3 * k + 1] = (
            moment / d[DATA.sd_moment],
            (d[DATA.moment] + turned) / d[DATA.sd_moment],
        )
        rows[3 * k + 2, at], right[3 * k + 2] = mean / d[DATA.sd_theta], d[DATA.theta] / d[DATA.sd_theta]
    return rows, right


def test_a_full_horizon_of_a_linear_joint_is_batch_least_squares():
    data = intervals(COUNT, 2)
    rows, right = linear_rows(data)
    batch = np.linalg.lstsq(rows, right, rcond=None)[0].reshape(-1, 2)
    start = np.zeros((COUNT + 1, 2)), np.zeros(4)
    found = problem.solve(SURE, problem.free(np.zeros(4), np.eye(4)), start, data, 1)
    np.testing.assert_allclose(found.nodes, batch, rtol=1e-6, atol=1e-6 * np.abs(batch).max())


def kalman(data):
    """Mean, covariance of the last node, and the sum of squared innovations, by a Kalman filter over all intervals.

    Both dynamic equations give x_1 = F x_0 + u + noise; the mean of theta measures x_0 and x_1 together.
    """
    mean, covariance, squares = np.zeros(2), np.eye(2), 0.0
    for d in data:
        rows, right = linear_rows(d[None])
        inverse = np.linalg.inv(rows[:2, 2:])
        F, u, Q = -inverse @ rows[:2, :2], inverse @ right[:2], inverse @ inverse.T
        H = rows[2, :2] + rows[2, 2:] @ F
        innovation = right[2] - H @ mean - rows[2, 2:] @ u
        cross = F @ covariance @ H + Q @ rows[2, 2:]
        variance = H @ covariance @ H + rows[2, 2:] @ Q @ rows[2, 2:] + 1.0
        squares += innovation**2 / variance
        mean = F @ mean + u + cross * innovation / variance
        covariance = F @ covariance @ F.T + Q - np.outer(cross, cross) / variance
    return mean, covariance, squares


def test_the_arrival_cost_of_a_linear_joint_is_the_kalman_filter():
    """Intervals leave five at a time; information, mean and innovations are those of the filter."""
    data = intervals(40, 3)
    arrival, squares = problem.free(np.zeros(4), np.eye(4)), 0.0
    arrival[[0, 1], [0, 1]] = 1.0  # a filter on covariances cannot begin without information
    for at in range(0, 35, 5):
        horizon = data[at : at + 10]
        start = np.zeros((len(horizon) + 1, 2)), np.zeros(4)
        found = problem.solve(SURE, arrival, start, horizon, 1)
        arrival, left = problem.leave(arrival, found, 5)
        squares += left
    mean, covariance, innovations = kalman(data[:35])
    inverse = np.linalg.inv(arrival[:, :-1])
    np.testing.assert_allclose((inverse @ inverse.T)[:2, :2], covariance, rtol=1e-5)
    np.testing.assert_allclose((inverse @ arrival[:, -1])[:2], mean, rtol=1e-6)
    assert squares == pytest.approx(innovations, rel=1e-5)


def test_a_random_step_of_the_unknowns_adds_its_variance():
    rng = np.random.default_rng(5)
    arrival = np.linalg.qr(rng.normal(size=(9, 7)), mode="r")[:6]
    directions = rng.normal(size=(4, 2))
    before, after = (np.linalg.inv(each[:, :-1]) for each in (arrival, problem.walk(arrival, directions, 0.3)))
    added = np.zeros((6, 6))
    added[2:, 2:] = 0.3 * directions @ directions.T
    np.testing.assert_allclose(after @ after.T, before @ before.T + added, rtol=1e-9, atol=1e-12)
    walked = problem.walk(arrival, directions, 0.3)
    np.testing.assert_allclose(after @ walked[:, -1], before @ arrival[:, -1], rtol=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_planted_motor_and_spring_are_recovered(friction):
    rows, truth = planted(count=5000, friction=friction)
    estimator = MovingHorizon(PLAIN)
    state, estimates = estimator.run_rows(rows)
    late = (rows[:, 0] > 2.0) & (estimates.status == Status.OK)
    assert late.mean() > 0.5
    np.testing.assert_allclose(estimates.value[late, 0], truth[late], rtol=0.01)
    assert estimates.column("motor_inertia_1")[0][-1] == pytest.approx(INERTIA, rel=0.01)
    assert estimates.column("motor_damping_1")[0][-1] == pytest.approx(DAMPING, rel=0.02)
    par = estimator._constants
    z = horizon_samples.views(par, horizon_samples.parts(par, state)[0])[5]
    assert estimator.model.width[2] * z[2] == pytest.approx(friction, abs=0.01)


def test_standard_deviations_match_the_scatter_between_seeds():
    known = replace(PLAIN, torque_noise=0.05, position_noise=5e-5)
    runs = [MovingHorizon(known).run_rows(planted(2000, seed=seed, noise=0.05)[0])[1] for seed in range(20)]
    looks = slice(1000, None, 100)
    scatter = np.std([each.value[looks, 0] for each in runs], axis=0, ddof=1)
    reported = np.sqrt(np.mean([each.standard_deviation[looks, 0] ** 2 for each in runs], axis=0))
    assert 0.8 < np.sqrt(np.mean(reported**2) / np.mean(scatter**2)) < 1.25


def test_samples_are_condensed_to_integrals_means_and_a_line():
    """Equal to numpy over the same samples, at unequal steps."""
    estimator, rng = MovingHorizon(PLAIN), np.random.default_rng(6)
    rows = rng.normal(size=(31, 4))
    rows[:, 0] = 2.0 + np.cumsum(1e-3 * rng.uniform(0.5, 1.5, 31))
    state, _ = estimator.run_rows(rows)
    par = estimator._constants
    _, _, data, nodes, *_ = horizon_samples.views(par, horizon_samples.parts(par, state)[0])
    for k in range(3):
        t, q, theta, tau = rows[10 * k : 10 * k + 11].T
        step, span, s = np.diff(t), t[-1] - t[0], t - t[0]
        rate, middle = np.polyfit(s - 0.5 * span, q, 1)
        assert data[k, DATA.span] == pytest.approx(span)
        assert data[k, DATA.impulse] == pytest.approx(step @ tau[1:])
        arms = 0.5 * span - 0.5 * (s[1:] + s[:-1])
        assert data[k, DATA.moment] == pytest.approx(step @ (arms * tau[1:]), abs=1e-12)
        line = middle + rate * span * np.array([-0.5, 0.0, 0.5])
        assert data[k, [DATA.q_start, DATA.q_middle, DATA.q_end]] == pytest.approx(line)
        assert data[k, DATA.theta] == pytest.approx(np.trapezoid(theta, t) / span)
        assert data[k, [DATA.low, DATA.high]] == pytest.approx([(q - theta).min(), (q - theta).max()])
        noise = (PLAIN.torque_noise**2 + (5.0 * POSITION_NOISE) ** 2) * span / 10.0
        assert data[k, DATA.sd_impulse] == pytest.approx(np.sqrt(noise * span))
        assert data[k, DATA.sd_moment] == pytest.approx(np.sqrt(noise * span / 12.0) * span)
        assert data[k, DATA.sd_theta] == pytest.approx(np.sqrt((POSITION_NOISE**2 + (1e-6) ** 2) / 10.0))
        assert nodes[k, 0] == theta[0] and nodes[k + 1] == pytest.approx([theta[-1], (theta[-1] - theta[0]) / span])


def test_stiffness_and_its_derivatives_are_those_of_the_spring_law():
    par = MovingHorizon(replace(PLAIN, order=2, even_terms=2, deflection_scale=0.8))._constants
    z, slope, step = np.array([0.1, -0.2, 0.3, 0.5, 0.2, -0.1, 0.4]), np.empty(7), 1e-6
    found, bend = horizon_samples.stiffness(par, z, 0.3, slope)
    a, share = 30.0 * z[3:] + np.array([5.0, 0.0, 0.0, 0.0]), 0.3 / 0.8
    assert found == pytest.approx(a @ [1.0, share**2, 0.0, share])  # powers 1, 3, 0 and 2 of the torque
    ends = [horizon_samples.stiffness(par, z, 0.3 + each, np.empty(7))[0] for each in (step, -step)]
    assert bend == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-6)
    for j, unit in enumerate(np.eye(7)):
        ends = [horizon_samples.stiffness(par, z + step * each, 0.3, np.empty(7))[0] for each in (unit, -unit)]
        assert slope[j] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-6)


def test_between_solutions_the_interval_grows_by_the_drift():
    own = replace(PLAIN, drift=0.1)
    rows, _ = planted(count=2003)
    state, _ = MovingHorizon(own).run_rows(rows)
    later = np.tile(rows[-1], (2, 1))
    later[:, 0] += [1e-3, 3e-3]
    one, other = (MovingHorizon(own).step(state, row)[1] for row in later)
    assert one.status == Status.OK and one.value[0] == other.value[0]
    grown = other.standard_deviation[1] ** 2 - one.standard_deviation[1] ** 2
    assert grown == pytest.approx(own.drift**2 * 2e-3 * one.value[1] ** 2, rel=1e-6)


def test_after_a_gap_the_unknowns_are_kept_and_the_angles_are_not():
    estimator, (rows, truth) = MovingHorizon(PLAIN), planted(count=4000)
    state, before = estimator.run_rows(rows[:3000])
    later = rows[3000:].copy()
    later[:, 0] += 5.0
    _, after = estimator.run_rows(later, state)
    assert np.all(np.abs(after.value[:, 0] / truth[3000:] - 1.0) < 0.02)
    again = np.flatnonzero(after.status == Status.OK)
    assert len(again) and again[0] >= PLAIN.window - 1  # the horizon fills anew
    assert after.column("motor_inertia_1")[0][0] == before.column("motor_inertia_1")[0][-1]


def test_a_horizon_shorter_than_the_step_between_solutions_is_refused():
    with pytest.raises(ParameterError, match="window must hold more than `every` = 5 intervals of 10 samples: 40"):
        replace(PLAIN, window=40)


def test_other_methods_do_not_load_casadi():
    code = (
        "import sys; from via_core.devices import load_device; from via_estimators.methods import estimator_for; "
        "estimator_for(load_device('qbmove_b')).load(); before = 'casadi' in sys.modules; "
        "estimator_for(load_device('qbmove_b'), 'moving_horizon').load(); print(before, 'casadi' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.split() == ["False", "True"]
