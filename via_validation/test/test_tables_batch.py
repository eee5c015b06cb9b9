"""Batch least squares on the integrated motor equation: planted truths, standard deviations, the printed forms."""

import numpy as np
import pytest
from via_core.errors import ParameterError, SignalError
from via_validation.tables.batch import batch_law, integral_rows

INERTIA, DAMPING = 0.02, 0.3


def record(count=3000, start=0.0):
    """Rows (count, 5) of time, q, theta, theta velocity, effort, and stiffness (count,) of 8 phi + 5 phi^3."""
    t = start + 1e-3 * np.arange(count)

    def motion(t):
        theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
        rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
        bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
        q = 0.5 * np.sin(4.0 * t)
        return q, theta, rate, INERTIA * bend + DAMPING * rate - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3

    q, theta, rate, _ = motion(t)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5e-3 * (node - 1.0))[3] for node, w in zip(nodes, weights, strict=True))
    return np.column_stack([t, q, theta, rate, effort]), 8.0 + 15.0 * (q - theta) ** 2


@pytest.mark.parametrize("basis", ["powers", "legendre", "odd_powers"])
def test_planted_parameters_come_back(basis):
    rows, truth = record()
    fitted = batch_law(rows.T, basis, 4)
    assert fitted.inertia == pytest.approx(INERTIA, rel=1e-4)
    assert fitted.damping == pytest.approx(DAMPING, rel=1e-4)
    value, _ = fitted.stiffness(rows[:, 1] - rows[:, 2])
    np.testing.assert_allclose(value, truth, rtol=2e-4)


def test_errata_36_without_a_constant_a_record_that_begins_in_motion_is_wrong():
    """The printed (36) has no B thd(0) + D theta(0)."""
    rows, truth = record(1000, start=0.3)
    columns, right = integral_rows(rows, "odd_powers", 2, 1.0)
    printed = np.linalg.lstsq(np.column_stack([columns[:, 1], rows[:, 2], columns[:, 3:]]), right, rcond=None)[0]
    phi = rows[:, 1] - rows[:, 2]
    wrong = np.column_stack([np.ones_like(phi), phi**2]) @ printed[2:]
    ours = batch_law(rows.T, "odd_powers", 2)
    assert np.mean((wrong - truth) ** 2) > 1e-3 > 1e-6 > np.mean((ours.stiffness(phi)[0] - truth) ** 2)
    assert abs(printed[1] / DAMPING - 1.0) > 5e-3 > 1e-5 > abs(ours.damping / DAMPING - 1.0)


def test_errata_39_the_integrals_of_the_basis_come_with_a_minus():
    """With the printed plus the same least squares gives stiffness of the wrong sign."""
    rows, truth = record()
    columns, right = integral_rows(rows, "odd_powers", 2, 1.0)
    columns[:, 3:] *= -1.0
    printed = np.linalg.lstsq(columns, right, rcond=None)[0]
    phi = rows[:, 1] - rows[:, 2]
    wrong = np.column_stack([np.ones_like(phi), phi**2]) @ printed[3:]
    right_one = batch_law(rows.T, "odd_powers", 2).stiffness(phi)[0]
    assert np.mean((right_one - truth) ** 2) < 1e-4
    assert np.mean((wrong - truth) ** 2) > 100.0


def test_deviations_hold():
    """Reported over empirical on 60 seeds; the textbook's s^2 P of the same rows is far too small."""
    clean, truth = record()
    phi = clean[:, 1] - clean[:, 2]
    errors, promised, naive = [], [], []
    for seed in range(60):
        rows = clean.copy()
        rows[:, 4] += 0.05 * np.random.default_rng(seed).normal(size=len(rows))
        fitted = batch_law(rows.T, "odd_powers", 2)
        value, sd = fitted.stiffness(phi[::50])
        errors.append([*(value - truth[::50]), fitted.inertia - INERTIA, fitted.damping - DAMPING])
        promised.append([*sd, *np.sqrt(np.diag(fitted.covariance)[:2])])
        columns, right = integral_rows(rows, "odd_powers", 2, 1.0)
        left = right - columns @ np.linalg.lstsq(columns, right, rcond=None)[0]
        naive.append(left.std() * np.sqrt(np.linalg.inv(columns.T @ columns)[1, 1]))
        assert fitted.torque_noise == pytest.approx(0.05, rel=0.06)
    errors, promised = np.array(errors), np.array(promised)
    ratio = np.sqrt(np.mean(promised**2, axis=0) / np.mean(errors**2, axis=0))
    assert 0.8 <= np.median(ratio[:-2]) <= 1.25 and ratio[-2:].min() >= 0.75 and ratio[-2:].max() <= 1.3
    assert np.mean(naive) < 0.3 * errors[:, -2].std()


def test_covariance_is_that_of_an_estimate_linear_in_every_torque_sample():
    """Brute force on uneven stamps: J_n is what one more N m in sample n does, Cov = r^2 J J'."""
    rows, _ = record(160)
    rows = rows[np.sort(np.random.default_rng(4).choice(160, 60, replace=False))]
    rows[:, 4] += 0.05 * np.random.default_rng(5).normal(size=len(rows))
    fitted = batch_law(rows.T, "odd_powers", 2)
    J = np.empty((4, len(rows)))
    for n in range(len(rows)):
        pushed = rows.copy()
        pushed[n, 4] += 1.0
        J[:, n] = batch_law(pushed.T, "odd_powers", 2).coefficients - fitted.coefficients
    np.testing.assert_allclose(fitted.covariance, fitted.torque_noise**2 * J @ J.T, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"basis": "guess"}, ParameterError, "no basis 'guess'"),
        ({"q": np.full(3000, np.nan)}, SignalError, "finite"),
        ({"tau": np.zeros(7)}, SignalError, "one length"),
        ({"q": None}, SignalError, "0: that unknown cannot be determined"),
    ],
)
def test_misuse_is_refused(change, error, message):
    rows, _ = record()
    arguments = dict(zip(("time", "q", "theta", "theta_velocity", "tau"), rows.T, strict=True))
    arguments |= change
    if arguments["q"] is None:
        arguments["q"] = arguments["theta"]
    basis = arguments.pop("basis", "powers")
    with pytest.raises(error, match=message):
        batch_law(list(arguments.values()), basis)
