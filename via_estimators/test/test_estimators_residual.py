"""The residual baseline: known truths, errors of a wrong motor, and the stability factor."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators.residual import Residual, ResidualParameters

INERTIA, DAMPING = 0.02, 0.3
ONE = ResidualParameters(
    transmissions=1, terms=2, inertia=INERTIA, damping=DAMPING, torque_noise=1e-3, acceleration=300.0,
    position_noise=1e-7, window=100,
)  # fmt: skip


def planted(count=4000):
    """Rows of one motor in prescribed motion, effort averaged over each interval; spring law 8 phi + 5 phi^3."""
    t = 1e-3 * np.arange(count)

    def motion(t):
        theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
        rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
        bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
        q = 0.5 * np.sin(4.0 * t)
        return q, theta, INERTIA * bend + DAMPING * rate - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3

    q, theta, _ = motion(t)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5e-3 * (node - 1.0))[2] for node, w in zip(nodes, weights, strict=True))
    return np.column_stack([t, q, theta, effort]), 8.0 + 15.0 * (q - theta) ** 2


@pytest.mark.parametrize("bandwidth", [30.0, 300.0])
@pytest.mark.parametrize("basis", ["odd_powers", "odd_legendre"])
def test_the_spring_law_is_recovered_at_any_bandwidth(bandwidth, basis):
    rows, truth = planted()
    _, estimates = Residual(replace(ONE, bandwidth=bandwidth, basis=basis)).run_rows(rows)
    converged = (estimates.status == Status.OK) & (rows[:, 0] > 1.0)
    assert converged.mean() > 0.6
    assert np.abs(estimates.value[:, 1] / truth - 1.0)[converged].max() < 2e-3


def test_the_declared_tolerance_covers_the_error_of_a_wrong_motor():
    """3 % of inertia and 10 % of damping too little, as in Section 4.2: the declared tolerance covers the error."""
    rows, truth = planted()
    wrong = replace(ONE, inertia=0.97 * INERTIA, damping=0.9 * DAMPING)
    declared = replace(wrong, inertia_tolerance=0.03 * INERTIA, damping_tolerance=0.1 * DAMPING)
    later = rows[:, 0] > 2.0
    error = {}
    for name, parameters in (("right", ONE), ("wrong", wrong), ("declared", declared)):
        value, sd = Residual(parameters).run_rows(rows)[1].column("stiffness_1")
        error[name] = np.sqrt(np.mean((value - truth)[later] ** 2)), np.sqrt(np.mean(sd[later] ** 2))
    assert error["wrong"][0] > 20.0 * error["right"][0]
    assert error["declared"][0] == error["wrong"][0]
    assert 0.5 < error["declared"][1] / error["declared"][0] < 4.0
    assert error["right"][1] < 0.2 * error["declared"][1]


def test_standard_deviations_match_empirical_ones_with_torque_noise():
    """Reported over empirical on 60 seeds, motor known."""
    clean, truth = planted()
    estimator = Residual(replace(ONE, torque_noise=0.05))
    errors, promised = [], []
    for seed in range(60):
        rows = clean.copy()
        rows[:, 3] += 0.05 * np.random.default_rng(seed).normal(size=len(rows))
        value, sd = estimator.run_rows(rows)[1].column("stiffness")
        errors.append((value - truth)[1000::50])
        promised.append(sd[1000::50])
    ratio = np.sqrt(np.mean(np.square(promised), axis=0) / np.mean(np.square(errors), axis=0))
    assert 0.8 <= np.median(ratio) <= 1.25


@pytest.mark.parametrize("c", [0.01, 100.0])
def test_errata_73_the_stability_factor_is_only_a_different_p_0(c):
    """c is plain least squares from c P(0): a prior sqrt(c) times as wide, at every sample."""
    rows, _ = planted(1500)
    weak = replace(ONE, stiffness_deviation=0.5, torque_noise=1.0)
    factored = Residual(replace(weak, stability=c)).run_rows(rows)[1]
    plain = Residual(replace(weak, stiffness_deviation=0.5 * np.sqrt(c))).run_rows(rows)[1]
    as_before = Residual(weak).run_rows(rows)[1]
    converged = factored.status == Status.OK
    np.testing.assert_allclose(factored.value[converged], plain.value[converged], rtol=1e-6)
    np.testing.assert_allclose(factored.standard_deviation[converged], plain.standard_deviation[converged], rtol=1e-6)
    assert np.abs(factored.value - as_before.value)[converged].max() > 1e-3


def test_devices_give_the_nominal_motor():
    parameters = Residual.from_device(load_device("vsa2")).parameters
    assert (parameters.inertia, parameters.damping, parameters.quantum) == (7.3e-3, 1e-3, 3.835e-4)
    with pytest.raises(ParameterError, match="no torque-driven transmission"):
        Residual.from_device(load_device("maccepavd"))


def test_standard_deviations_match_empirical_ones_for_motor_errors_as_declared():
    """Tolerances as qbmove_a's device file gives them; inertia, damping wrong by one each, all four signs."""
    rows, truth = planted(2500)
    nominal = Residual.from_device(load_device("qbmove_a")).parameters
    inertia = INERTIA * nominal.inertia_tolerance / nominal.inertia
    damping = DAMPING * nominal.damping_tolerance / nominal.damping
    declared = replace(ONE, inertia_tolerance=inertia, damping_tolerance=damping)
    later, promised, missed = slice(1500, None), [], []
    for sign, other in product((-1.0, 1.0), repeat=2):
        believed = replace(declared, inertia=INERTIA + sign * inertia, damping=DAMPING + other * damping)
        value, sd = Residual(believed).run_rows(rows)[1].column("stiffness_1")
        promised.append(sd[later])
        missed.append((value - truth)[later])
    ratio = np.sqrt(np.mean(np.square(promised)) / np.mean(np.square(missed)))
    assert 0.8 < ratio < 1.6  # measured 1.46: too wide, see the module's docstring


@pytest.mark.parametrize("which", ["inertia", "damping"])
def test_each_tolerance_contributes_the_effect_of_its_error(which):
    """The estimate is linear in the motor's parameters, so the tolerance contributes that difference."""
    rows, _ = planted(2000)
    off = 0.1 * getattr(ONE, which)
    declared = Residual(replace(ONE, **{f"{which}_tolerance": off})).run_rows(rows)[1]
    wrong = Residual(replace(ONE, **{which: getattr(ONE, which) + off})).run_rows(rows)[1]
    right = Residual(ONE).run_rows(rows)[1]
    later = slice(1500, None)
    share = np.sqrt(declared.standard_deviation[later] ** 2 - right.standard_deviation[later] ** 2)
    np.testing.assert_allclose(share, np.abs(wrong.value - right.value)[later], rtol=1e-6, atol=1e-9)
    assert share.max() > 0.01


def test_default_tolerances_are_5_and_10_percent():
    own = Residual.from_device(load_device("qbmove_a")).parameters
    assert own.inertia_tolerance == pytest.approx(0.05 * own.inertia)
    assert own.damping_tolerance == pytest.approx(0.1 * own.damping)


def test_the_prior_does_not_bias_the_result():
    """A wrong prior has no effect: its torque is subtracted from the residual and its stiffness added again."""
    rows, truth = planted()
    value, _ = Residual(replace(ONE, stiffness_prior=40.0)).run_rows(rows)[1].column("stiffness")
    assert np.abs(value / truth - 1.0)[1500:].max() < 2e-3


def test_after_a_gap_the_low_pass_starts_at_the_current_deflection():
    """Ten time constants later exp(-10) of a deflection before the gap remains, which would dominate a small one."""
    rows, _ = planted(2500)
    rows[:, 1:] *= 1e-4
    late = rows[1000:] + np.array([10.0, 0.0, 0.0, 0.0])
    held = np.array([[1e-3 * k, 1.0, 0.0, -13.0] for k in range(500)])  # at rest: no row is made of these
    small = Residual(replace(ONE, bandwidth=30.0, minimum_motion=1e-5))
    fresh, after = small.run_rows(late)[1], small.run_rows(np.vstack([held, late]))[1]
    np.testing.assert_allclose(after.value[500:], fresh.value, rtol=1e-9, atol=1e-9)
