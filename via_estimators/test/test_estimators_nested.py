"""The mixture of an estimate with the model in which one unknown has a stated value."""

import numpy as np
import pytest
from via_estimators.nested import allow, odds_of


def least_squares(rows, y, known):
    """Mean, covariance and log evidence of y = rows x + e, e ~ N(0, 1), x ~ N(0, 1) but for `known` {j: value}."""
    free = [j for j in range(rows.shape[1]) if j not in known]
    rest = y - sum(rows[:, j] * value for j, value in known.items())
    part = rows[:, free]
    P = np.linalg.inv(part.T @ part + np.eye(len(free)))
    x = P @ part.T @ rest
    total = np.eye(len(y)) + part @ part.T
    evidence = -0.5 * (rest @ np.linalg.solve(total, rest) + np.linalg.slogdet(total)[1])
    mean, covariance = np.zeros(rows.shape[1]), np.zeros((rows.shape[1],) * 2)
    mean[free], covariance[np.ix_(free, free)] = x, P
    for j, value in known.items():
        mean[j] = value
    return mean, covariance, evidence


@pytest.mark.parametrize("truth", [0.0, 0.1, 0.4, 3.0])
@pytest.mark.parametrize("value", [0.0, -0.7])
@pytest.mark.parametrize("odds", [1.0, 5.0])
def test_it_is_the_mixture_of_both_least_squares_by_their_evidence(truth, value, odds):
    random = np.random.default_rng(3)
    rows = random.standard_normal((30, 3)) @ np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.3], [0.0, 0.0, 1.0]])
    y = rows @ np.array([0.5, -0.3, truth]) + random.standard_normal(30)
    whole, simpler = least_squares(rows, y, {}), least_squares(rows, y, {2: value})
    weight = 1.0 / (1.0 + np.exp(whole[2] - simpler[2]) / odds)
    mean = (1.0 - weight) * whole[0] + weight * simpler[0]
    covariance = sum(
        share * (each[1] + np.outer(each[0] - mean, each[0] - mean))
        for share, each in ((1.0 - weight, whole), (weight, simpler))
    )
    x, P = whole[0].copy(), whole[1].copy()
    allow(x, P, 2, value, odds)
    np.testing.assert_allclose(x, mean, atol=1e-9)
    np.testing.assert_allclose(P, covariance, atol=1e-9)


def test_an_effect_that_the_data_exclude_leaves_the_simpler_model():
    x, P = np.array([1.0, 0.0]), np.array([[1e-4, 5e-5], [5e-5, 1e-4]])
    allow(x, P, 1, 0.0, 1.0)
    assert P[0, 0] == pytest.approx(1e-4 - 25e-6, rel=0.02)


def test_an_unknown_without_variance_is_left_alone():
    x, P = np.array([1.0, 2.0]), np.zeros((2, 2))
    allow(x, P, 1, 0.0, 1.0)
    assert x.tolist() == [1.0, 2.0] and not P.any()


def test_no_effect_at_all_is_as_probable_as_any_before_data():
    absent = odds_of(6)
    assert (absent / (1.0 + absent)) ** 6 == pytest.approx(0.5)
