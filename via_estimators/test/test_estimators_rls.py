"""Recursive least squares on P: the normal equations, the printed recursion, and the effect of the factor c."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_estimators import rls
from via_estimators.qr import inverse_normal, rotate_in, solve_triangular


def folded(rows, y, c=1.0, prior=1e4):
    """P, w and innovations after all rows."""
    n = rows.shape[1]
    P, w, gain = np.empty((n, n)), np.empty(n), np.empty(n)
    rls.start(P, w, prior)
    return P, w, [rls.update(P, w, row, value, c, gain) for row, value in zip(rows, y, strict=True)]


def problem(seed, count=40, n=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, n)), rng.normal(size=count)


@settings(max_examples=50, deadline=None)
@given(n=st.integers(1, 8), count=st.integers(0, 40), seed=st.integers(0, 2**32 - 1), prior=st.floats(1e-3, 1e5))
def test_the_recursion_is_least_squares_with_the_prior(n, count, seed, prior):
    rows, y = problem(seed, count, n)
    P, w, _ = folded(rows, y, prior=prior)
    normal = rows.T @ rows + np.eye(n) / prior
    np.testing.assert_allclose(w, np.linalg.solve(normal, rows.T @ y), atol=1e-6)
    np.testing.assert_allclose(P @ normal, np.eye(n), atol=1e-6)
    assert np.array_equal(P, P.T) and np.linalg.eigvalsh(P).min() > 0.0


@pytest.mark.parametrize("c", [1.0, 0.2, 7.0])
def test_equations_66_to_73_as_printed(c):
    rows, y = problem(2)
    P, w = 1e4 * np.eye(4), np.zeros(4)
    for v, value in zip(rows, y, strict=True):
        epsilon, r = value - v @ w, v @ P @ v
        k, alpha = P @ v / (1.0 + r), c * (1.0 + r) / (1.0 + c * r)
        w = w + alpha * k * epsilon
        P = (np.eye(4) - alpha * np.outer(k, v)) @ P
    ours = folded(rows, y, c)
    np.testing.assert_allclose(ours[0], P, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(ours[1], w, rtol=1e-9)
    assert ours[2][-1] == pytest.approx(epsilon)


def test_the_stability_factor_is_only_a_different_prior():
    """(73) as a cure for poor excitation equals P(0) -> c P(0): P grows in the direction at rest all the same."""
    rows, y = problem(3)
    rows[:, 3] = 0.0  # never excited
    for c in (0.1, 20.0):
        P, w, _ = folded(rows, y, c, prior=10.0)
        other_P, other_w, _ = folded(rows, y, 1.0, prior=10.0 * c)
        np.testing.assert_allclose(w, other_w, rtol=1e-9)
        np.testing.assert_allclose(c * P, other_P, rtol=1e-9)
        assert P[3, 3] == 10.0


def test_gain_and_innovation_are_those_of_the_step():
    rows, y = problem(4)
    P, w, _ = folded(rows[:-1], y[:-1])
    before, gain = w.copy(), np.empty(4)
    innovation = rls.update(P, w, rows[-1], y[-1], 1.0, gain)
    assert innovation == pytest.approx(y[-1] - rows[-1] @ before)
    np.testing.assert_allclose(w - before, gain * innovation, rtol=1e-9)


def test_equal_to_rotations_with_the_root_of_the_prior():
    """P(0) = prior I is R(0) = I / sqrt(prior): the same estimate and the same covariance."""
    rows, y = problem(5)
    P, w, _ = folded(rows, y, prior=1e4)
    R, p, x, inverse, other = 1e-2 * np.eye(4), np.zeros(4), np.empty(4), np.empty((4, 4)), np.empty((4, 4))
    for row, value in zip(rows, y, strict=True):
        rotate_in(R, p, row.copy(), value, 0)
    solve_triangular(R, p, x)
    inverse_normal(R, inverse, other)
    np.testing.assert_allclose(w, x, rtol=1e-8)
    np.testing.assert_allclose(P, other, rtol=1e-6)
