"""The triangular update compared with batch least squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_estimators.qr import inverse_normal, reflect_in, rotate_in, solve_triangular


def folded(rows, y, factor=1.0, prior=1e-3):
    """R, p, x after taking all rows, R and p multiplied by `factor` before each."""
    n = rows.shape[1]
    R, p, x = prior * np.eye(n), np.zeros(n), np.empty(n)
    left = []
    for row, value in zip(rows, y, strict=True):
        R *= factor
        p *= factor
        left.append(rotate_in(R, p, row.copy(), value, 0))
    solve_triangular(R, p, x)
    return R, p, x, np.array(left)


def regularised(rows, y, weights, prior_weight):
    """argmin sum w (row' x - y)^2 + prior_weight |x|^2 by the normal equations."""
    left = (rows * weights[:, None]).T @ rows + prior_weight * np.eye(rows.shape[1])
    return np.linalg.solve(left, (rows * weights[:, None]).T @ y)


def test_successive_rows_solve_the_least_squares_problem():
    rng = np.random.default_rng(1)
    rows, y = rng.normal(size=(60, 5)), rng.normal(size=60)
    R, _, x, left = folded(rows, y)
    np.testing.assert_allclose(x, regularised(rows, y, np.ones(60), 1e-6), atol=1e-9)
    np.testing.assert_allclose(R.T @ R, rows.T @ rows + 1e-6 * np.eye(5), rtol=1e-10, atol=1e-9)
    # what the rotations leave over is the residual sum of squares (with the prior's part)
    assert np.sum(left**2) == pytest.approx(np.sum((rows @ x - y) ** 2) + 1e-6 * x @ x, rel=1e-9)


def test_forgetting_in_the_usual_meaning_is_the_square_root_of_lambda():
    rng = np.random.default_rng(2)
    rows, y, keep = rng.normal(size=(200, 3)), rng.normal(size=200), 0.98
    usual = regularised(rows, y, keep ** np.arange(199, -1, -1), 1e-6 * keep**200)
    np.testing.assert_allclose(folded(rows, y, np.sqrt(keep))[2], usual, rtol=1e-8)
    # as printed in (47), (48) the factor is lambda itself, which forgets twice as fast
    assert np.abs(folded(rows, y, keep)[2] - usual).max() > 1e-2


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 7), st.integers(0, 30), st.integers(0, 2**32 - 1))
def test_the_factor_stays_triangular_and_its_inverse_is_the_inverse(n, count, seed):
    rng = np.random.default_rng(seed)
    R = folded(rng.normal(size=(count, n)), rng.normal(size=count), prior=0.1)[0]
    assert np.array_equal(R, np.triu(R)) and np.all(np.diag(R) > 0.0)
    inverse, P = np.empty((n, n)), np.empty((n, n))
    inverse_normal(R, inverse, P)
    np.testing.assert_allclose(P @ (R.T @ R), np.eye(n), atol=1e-8)
    assert np.array_equal(P, P.T) and np.linalg.eigvalsh(P).min() > 0.0


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2), st.integers(0, 2), st.floats(1e-4, 10.0), st.integers(0, 2**32 - 1))
def test_reflecting_a_staircase_of_rows_equals_rotating_in_each(n, beside, first, size, seed):
    rng, first = np.random.default_rng(seed), min(first, n - 1)
    k, m = n - first, n + beside
    R = np.triu(rng.normal(size=(n, m)))
    R[np.arange(n), np.arange(n)] = rng.uniform(0.5, 2.0, n)
    rows, y, p = size * np.triu(rng.normal(size=(k, m)), first), rng.normal(size=k), rng.normal(size=n)
    rows[np.arange(k), first + np.arange(k)] = size
    one, right, left = R.copy(), p.copy(), 0.0
    for i in range(k):
        left += rotate_in(one, right, rows[i].copy(), y[i], first + i) ** 2
    found = reflect_in(R, p, np.ascontiguousarray(rows.T), y.copy(), first)
    np.testing.assert_allclose(R, one, atol=1e-12 * (1.0 + size))
    np.testing.assert_allclose(p, right, atol=1e-12 * (1.0 + size))
    assert found == pytest.approx(left, rel=1e-9, abs=1e-20)
