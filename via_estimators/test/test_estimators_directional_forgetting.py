"""Algorithm 1's recursion: equal to the printed one under excitation, stable at standstill."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_estimators import directional_forgetting

RESTLESS = (0.99, 0.9, 100.0)  # lambda_c, lambda_min, rho: forgets at every row


def printed(rows, torque, forgetting, delta, start=1.0):
    """Algorithm 1 to the letter; histories of w (N, n), P (N, n, n) and lambda (N,)."""
    decay, least, sensitivity = forgetting
    n = rows.shape[1]
    P, w, energy = start * np.eye(n), np.zeros(n), 0.0
    out = []
    with np.errstate(all="ignore"):
        for v, y in zip(rows, torque, strict=True):
            error = y - v @ w
            energy = decay * energy + error**2
            keep = least + (1.0 - least) * 2.0 ** -np.round(sensitivity * error**2 / energy)
            r = v @ P @ v
            beta = keep - (1.0 - keep) / r if r > 0.0 else 1.0
            w = w + P @ v / (1.0 + r) * error
            P = (np.eye(n) - np.outer(P @ v, v) / (1.0 / beta + r)) @ P + delta * np.eye(n)
            out.append((w, P, keep))
    return tuple(np.array(each) for each in zip(*out, strict=True))


def safe(rows, torque, forgetting, delta, start=1.0, limit=1e12, floor=1e-12):
    """The kernels in the same order; histories of w, P and lambda."""
    decay, least, sensitivity = forgetting
    n = rows.shape[1]
    R, w, gain, spare, energy = np.sqrt(start) * np.eye(n), np.zeros(n), np.zeros(n), np.zeros((2, n)), 0.0
    out = []
    for v, y in zip(rows, torque, strict=True):
        error = y - v @ w
        energy = decay * energy + error**2
        keep = directional_forgetting.forgetting_factor(error, max(energy, floor), sensitivity, least)
        directional_forgetting.update(R, v, keep, limit, gain, spare[0], spare[1])
        w = w + gain * error
        directional_forgetting.grow(R, delta, limit, spare[0], spare[1])
        out.append((w, R.T @ R, keep))
    return tuple(np.array(each) for each in zip(*out, strict=True))


def excited(n, count=400, seed=0):
    """Rows of odd powers of a random velocity, and a torque with noise."""
    rng = np.random.default_rng(seed)
    velocity = 1.5 * np.sin(0.05 * np.arange(count)) + 0.4 * np.sin(0.13 * np.arange(count) + 1.0)
    rows = velocity[:, None] ** (2 * np.arange(n) + 1)
    return rows, rows @ np.array([3.0, -0.4, 0.05])[:n] + 0.05 * rng.normal(size=count)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("forgetting", [RESTLESS, (0.99, 0.98, 10.0), (0.95, 1.0, 1.0)])
def test_on_excited_data_it_is_the_printed_algorithm(n, forgetting):
    rows, torque = excited(n)
    theirs, ours = (each(rows, torque, forgetting, 1e-3) for each in (printed, safe))
    for printed_history, history in zip(theirs, ours, strict=True):
        np.testing.assert_allclose(history, printed_history, rtol=1e-7, atol=1e-9)
    if forgetting is RESTLESS:
        assert ours[2].min() < 0.95  # it did forget


def test_errata_76_beta_overflows_at_standstill_and_the_expanded_form_does_not():
    rows, torque = excited(2, count=9000)
    dying = np.exp(-np.maximum(np.arange(9000) - 400, 0) / 50.0)
    noise, velocity = torque - rows @ [3.0, -0.4], rows[:, 0] * dying
    rows = np.column_stack([velocity, velocity**3])
    torque = rows @ [3.0, -0.4] + noise
    _, P, _ = printed(rows, torque, RESTLESS, 1e-3)
    with np.errstate(all="ignore"):
        definite = [bool(np.isfinite(each).all() and np.linalg.eigvalsh(each + each.T)[0] > 0.0) for each in P]
    assert all(definite[:400]) and not all(definite)
    w, P, _ = safe(rows, torque, RESTLESS, 1e-3, limit=10.0)
    eigenvalues = np.linalg.eigvalsh(P)
    assert eigenvalues.min() > 0.0
    assert eigenvalues.sum(axis=1).max() <= 2 * (10.0 / 0.9 + 10.0 + 1e-3)
    assert np.abs(w).max() < 10.0


def test_errata_75_delta_accumulates_in_a_direction_without_excitation():
    rows = np.tile([1.0, 0.0], (40_000, 1))
    torque = np.ones(len(rows))
    _, P, _ = printed(rows, torque, (0.99, 1.0, 0.0), 0.01)
    assert P[-1, 1, 1] == pytest.approx(401.0)  # and on it goes
    _, P, _ = safe(rows, torque, (0.99, 1.0, 0.0), 0.01, limit=10.0)
    assert P[-1, 1, 1] <= 10.0 and P[-1, 1, 1] == pytest.approx(10.0, rel=1e-6)
    assert P[-1, 0, 0] == pytest.approx(P[1000, 0, 0], rel=1e-3)  # and the direction visited still grows as before


def test_errata_78_79_the_first_row_at_rest_is_0_over_0_without_a_floor():
    rest, none = np.zeros((3, 1)), np.zeros(3)
    assert np.isnan(printed(rest, none, RESTLESS, 0.0)[2]).all()
    assert np.all(safe(rest, none, RESTLESS, 0.0)[2] == 1.0)


def test_forgetting_acts_only_along_the_row():
    R, gain, spare = np.linalg.cholesky(np.array([[2.0, 0.3], [0.3, 1.0]])).T.copy(), np.zeros(2), np.zeros((2, 2))
    before = R.T @ R
    v = np.array([0.01, 0.0])
    directional_forgetting.update(R, v, 0.8, 1e12, gain, spare[0], spare[1])
    information = np.linalg.inv(R.T @ R) - np.linalg.inv(before)
    beta = 0.8 - 0.2 / (v @ before @ v)
    np.testing.assert_allclose(information, beta * np.outer(v, v), atol=1e-9)
    np.testing.assert_allclose(gain, before @ v / (1.0 + v @ before @ v), rtol=1e-12)


def test_in_one_dimension_p_converges_to_the_gain_of_exponential_forgetting():
    """r = (1 - lambda) / lambda: the gain of exponential forgetting."""
    R, gain, spare = np.ones((1, 1)), np.zeros(1), np.zeros((2, 1))
    for _ in range(3000):
        directional_forgetting.update(R, np.array([0.3]), 0.97, 1e12, gain, spare[0], spare[1])
    assert (0.3 * R[0, 0]) ** 2 == pytest.approx(0.03 / 0.97, rel=1e-9)
    assert 0.3 * gain[0] == pytest.approx(0.03, rel=1e-9)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_p_stays_definite_and_bounded_for_all_rows(data):
    n = data.draw(st.integers(1, 3))
    limit = 10.0 ** data.draw(st.floats(-3, 6))
    delta = data.draw(st.floats(0.0, 0.01))
    speeds = st.one_of(st.just(0.0), st.floats(-1e3, 1e3), st.floats(-1e-12, 1e-12), st.floats(-1.0, 1.0))
    velocities = data.draw(st.lists(speeds, min_size=1, max_size=40))
    least = data.draw(st.floats(0.5, 1.0))
    R, gain, spare = np.sqrt(min(1.0, limit)) * np.eye(n), np.zeros(n), np.zeros((2, n))
    largest = 0.0
    for velocity in velocities * 3:
        directional_forgetting.update(R, velocity ** (2.0 * np.arange(n) + 1), least, limit, gain, spare[0], spare[1])
        directional_forgetting.grow(R, delta, limit, spare[0], spare[1])
        largest = max(largest, directional_forgetting.trace(R))
        assert np.isfinite(R).all() and np.isfinite(gain).all()
        assert np.linalg.eigvalsh(R.T @ R)[0] >= -1e-12 * directional_forgetting.trace(R)
    assert largest <= 1.0001 * n * (limit / least + limit + delta)
