"""Section 3's estimator: known truths, the corrected equations in plain numpy, the printed ones, and Table 2.

Each erratum is shown on a joint in prescribed motion whose torque follows from the motor equation itself.
"""

from dataclasses import replace
from math import factorial

import numpy as np
import pytest
from via_core.status import Status
from via_core.weak_form import modulating, window_weights
from via_estimators import rls
from via_estimators.modulated_stiffness import ModulatedStiffness, ModulatedStiffnessParameters

H, PERIOD, SPAN = 200, 1e-3, 0.2
INERTIA, DAMPING = 0.02, 0.3
ALPHA = (8.0, 0.0, 30.0)  # sigma = 8 + 15 phi^2
ONE = ModulatedStiffness(
    ModulatedStiffnessParameters(
        transmissions=1,
        window=H,
        motor_inertia_1=INERTIA,
        motor_damping_1=DAMPING,
        initial_covariance=1e14,
        torque_noise=1e-2,
        position_noise=0.0,
    )
)


def motion(t):
    """q, theta and the corresponding motor torque."""
    theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
    rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
    acceleration = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
    q = 0.5 * np.sin(4.0 * t)
    return q, theta, INERTIA * acceleration + DAMPING * rate - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3


def planted(count=3000, jitter=0.0, begin=0.0):
    """Rows (count, 4) with the torque constant over the interval that ends at its stamp, and the true stiffness."""
    t = begin + PERIOD * (np.arange(count) + jitter * np.random.default_rng(0).uniform(-0.5, 0.5, count))
    q, theta, _ = motion(t)
    step = np.diff(t, prepend=t[0] - PERIOD)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    effort = sum(0.5 * w * motion(t + 0.5 * step * (node - 1.0))[2] for node, w in zip(nodes, weights, strict=True))
    return np.column_stack([t, q, theta, effort]), 8.0 + 15.0 * (q - theta) ** 2


def document(order=3, size=H, span=SPAN, backwards=False, sign=-1.0):
    """Weights (3, H + 1) of (26), (27) in the document's scale: T^2 W dw, T W d2w, W d3w for samples k-H .. k.

    backwards  as printed: sample k - m at m/H;  sign  of the first term of (30), printed +
    """
    u = np.arange(size + 1) / size
    W = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size
    third = modulating(order, 3, u) + (sign + 1.0) * 6.0 * u**3
    rows = np.stack([span**2 * modulating(order, 1, u), span * modulating(order, 2, u), third]) * W
    return rows[:, ::-1] if backwards else rows


def fir(weights, signal):
    return np.convolve(signal, weights[::-1], "valid")


def recursion(q, theta, tau, weights, terms=3, prior=1e14):
    """alpha (k, terms) by (25)-(27) and RLS on P, torque treated as a sampled curve."""
    first, second, third = weights
    phi = q - theta
    C = fir(INERTIA * third - DAMPING * second, theta) - fir(first, tau)
    gamma = [fir(first, phi ** (j + 1) / factorial(j + 1)) for j in range(terms)]
    P, w, gain, found = np.empty((terms, terms)), np.empty(terms), np.empty(terms), []
    rls.start(P, w, prior)
    for v, y in zip(np.array(gamma).T, C, strict=True):
        rls.update(P, w, v.copy(), y, 1.0, gain)
        found.append(w.copy())
    return np.array(found)


def sampled(count=2000, offset=0.0, begin=0.0):
    q, theta, tau = motion(begin + PERIOD * np.arange(count))
    return q + offset, theta + offset, tau


def estimated(rows, **changes):
    """alpha (3,) of the estimator with changed parameters."""
    estimator = ModulatedStiffness(replace(ONE.parameters, **changes))
    return estimator.coefficients(estimator.run_rows(rows)[0])[0]


@pytest.mark.parametrize("jitter", [0.0, 0.8])
@pytest.mark.parametrize("order", [3, 4, 5])
def test_stiffness_is_recovered(jitter, order):
    rows, truth = planted(jitter=jitter)
    estimator = ModulatedStiffness(replace(ONE.parameters, modulating_order=order))
    state, estimates = estimator.run_rows(rows)
    converged = estimates.status == Status.OK
    assert converged.mean() > 0.7
    assert np.abs(estimates.value[:, 0] - truth)[converged].max() < 2e-3 * truth.max()
    np.testing.assert_allclose(estimator.coefficients(state)[0], ALPHA, atol=0.02)


def test_before_a_full_window_missing_samples_are_not_zeros():
    rows, truth = planted(begin=5.0)
    _, estimates = ONE.run_rows(rows)
    assert np.all(estimates.status[: 2 * H] == Status.WARMING_UP)
    converged = estimates.status == Status.OK
    assert np.abs(estimates.value[:, 0] - truth)[converged].max() < 2e-3 * truth.max()


def test_k_below_h_filled_with_zeros_as_printed_is_right_only_from_rest():
    """A log that begins in motion: the step from zero to its first sample is permanently treated as data."""
    signals = sampled(begin=5.0)
    filled = recursion(*(np.concatenate([np.zeros(H), signal]) for signal in signals), document())[-1]
    waiting = recursion(*signals, document())[-1]
    assert np.abs(waiting - ALPHA).max() < 0.05
    assert np.abs(filled - ALPHA).max() > 2.0


def test_equal_to_rls_on_rows_in_the_document_scale_with_its_own_p0():
    """The triangular factor with the prior P(0) and RLS on P give the same estimate, with the same weights."""
    rows, _ = planted()
    state, _ = ONE.run_rows(rows)
    psi = window_weights(3, SPAN * np.arange(H + 1) / H, 4) * SPAN**3 / 140.0  # c_3 = 140
    density = psi[0] / PERIOD
    held = np.diff(density, prepend=0.0)
    q, theta, tau = rows[:, 1:].T
    C = INERTIA * fir(psi[3], theta) - DAMPING * fir(psi[2], theta) - fir(held, tau)
    gamma = np.stack([fir(psi[1], (q - theta) ** (j + 1) / [1.0, 2.0, 6.0][j]) for j in range(3)], axis=1)
    for prior in (1e8, 1.0):
        state, _ = ModulatedStiffness(replace(ONE.parameters, initial_covariance=prior)).run_rows(rows)
        P, w, gain = np.empty((3, 3)), np.empty(3), np.empty(3)
        rls.start(P, w, prior)
        for v, y in zip(gamma, C, strict=True):
            rls.update(P, w, v.copy(), y, 1.0, gain)
        found = ModulatedStiffness(replace(ONE.parameters, initial_covariance=prior)).coefficients(state)[0]
        np.testing.assert_allclose(found, w, rtol=1e-5, atol=1e-5)
    assert np.abs(w - ALPHA).max() > 0.1  # P(0) = 1 is a prior that is felt, so that the scale has been tested


def test_the_corrected_trapezoid_form_is_the_same_up_to_its_discretisation():
    q, theta, tau = sampled(3000)
    state, _ = ONE.run_rows(planted()[0])
    ours = ONE.coefficients(state)[0]
    trapezoid = recursion(q, theta, tau, document())[-1]
    np.testing.assert_allclose(trapezoid, ours, atol=0.05)
    np.testing.assert_allclose(ours, ALPHA, atol=0.02)
    assert np.abs(ours - ALPHA).max() < np.abs(trapezoid - ALPHA).max()  # and the correction of the weights helps


def test_equations_26_and_27_as_printed_pair_samples_backwards_and_flip_the_damping():
    q, theta, tau = sampled()
    ours, printed = estimated(planted(2000)[0]), recursion(q, theta, tau, document(backwards=True))[-1]
    assert np.abs(printed - ALPHA).max() > 5.0
    np.testing.assert_allclose(ours, ALPHA, atol=0.02)
    # it is the D term: with -D, the printed form is right, and ours as wrong as the printed one is with D
    other = document(backwards=True) * np.array([[1.0], [-1.0], [1.0]])
    np.testing.assert_allclose(recursion(q, theta, tau, other)[-1], ours, atol=0.05)


def test_equation_30_as_printed_depends_on_an_offset_of_the_angles():
    """An offset of 10 rad on both angles must not change the estimate."""
    printed = recursion(*sampled(offset=10.0), document(sign=1.0))[-1]
    assert np.abs(printed - ALPHA).max() > 100.0
    rows, _ = planted(2000)
    offset = rows.copy()
    offset[:, 1:3] += 10.0
    np.testing.assert_allclose(estimated(offset), ALPHA, atol=0.02)
    np.testing.assert_allclose(ONE.run_rows(offset)[1].value, ONE.run_rows(rows)[1].value, rtol=1e-6, atol=1e-6)


def test_equations_19_to_26_hold_the_motor_torque_and_not_the_flexibility_torque():
    """The estimator uses the motor torque; the printed equations use tau_e instead."""
    rows, _ = planted(2000)
    q, theta, _ = sampled()
    flexibility = 8.0 * (q - theta) + 5.0 * (q - theta) ** 3
    np.testing.assert_allclose(estimated(rows), ALPHA, atol=0.02)
    swapped = rows.copy()
    swapped[:, 3] = flexibility
    printed = recursion(q, theta, flexibility, document())[-1]
    assert np.abs(printed - ALPHA).max() > 5.0
    np.testing.assert_allclose(estimated(swapped), printed, atol=0.3)  # the same mistake, made by our own code


@pytest.mark.parametrize("size", [150, 300])
def test_equation_23_is_equation_22_divided_by_the_fourth_power(size):
    """(22) by quadrature, psi(s) = (s - t + T)^3 (t - s)^3, over T^4: with a small P(0), the scale of the rows matters.

    With T^3 as printed the prior would count T^2 times as much, and the estimator would say something else.
    """
    span, prior, count = size * PERIOD, 1e6, 1200
    nodes, weights = np.polynomial.legendre.leggauss(24)
    first = np.polynomial.Polynomial.fromroots([0.0] * 3) * -np.polynomial.Polynomial.fromroots([span] * 3)
    own, weights = 0.5 * span * (nodes + 1.0), 0.5 * span * weights
    found = {}
    for power in (4, 3):
        P, w, gain = np.empty((3, 3)), np.empty(3), np.empty(3)
        rls.start(P, w, prior)
        for end in PERIOD * np.arange(size, count):
            q, theta, tau = motion(end - span + own)
            modulated = [weights * first.deriv(i)(own) / span**power for i in (1, 2, 3)]
            y = INERTIA * modulated[2] @ theta - DAMPING * modulated[1] @ theta - modulated[0] @ tau
            v = np.array([modulated[0] @ (q - theta) ** (j + 1) / factorial(j + 1) for j in range(3)])
            rls.update(P, w, v, y, 1.0, gain)
        found[power] = w
    ours = estimated(planted(count)[0], window=size, initial_covariance=prior)
    np.testing.assert_allclose(ours, found[4], rtol=2e-3, atol=2e-3)
    assert np.abs(found[3] - found[4]).max() > 0.5


def test_equation_24_as_printed_reduces_the_weight_of_rows_relative_to_p0():
    """With W = T_s in place of 1/H the prior would have 1/T^2 = 25 times the weight; here it has not."""
    q, theta, tau = sampled()
    prior = 1e6
    right, printed = (recursion(q, theta, tau, scale * document(), prior=prior)[-1] for scale in (1.0, SPAN))
    ours = estimated(planted(2000)[0], initial_covariance=prior)
    away = np.abs(printed - right).max()
    assert away > 0.5
    assert np.abs(ours - right).max() < 0.1 * away


def test_standard_deviations_match_empirical_ones_and_the_naive_ones_are_too_small():
    """40 runs; sigma^2 P assumes independent residuals and is far too small."""
    rows, truth = planted()
    estimator = ModulatedStiffness(replace(ONE.parameters, torque_noise=0.3))
    errors, sds = [], []
    for seed in range(40):
        noisy = rows.copy()
        noisy[:, 3] += 0.3 * np.random.default_rng(seed).normal(size=len(rows))
        _, estimates = estimator.run_rows(noisy)
        errors.append((estimates.value[:, 0] - truth)[1000::50])
        sds.append(estimates.standard_deviation[1000::50, 0])
    ratio = np.sqrt(np.mean(np.square(sds)) / np.mean(np.square(errors)))
    assert 0.8 <= ratio <= 1.25


# The ways of an angle's noise: through the third, the second and, by way of the spring, the first derivative of psi.
@pytest.mark.parametrize(
    ("inertia", "damping", "stiffness", "torque"),
    [(0.3, 0.0, 1.0, 0.3), (0.0, 20.0, 1.0, 0.3), (0.3, 0.0, 300.0, 1e-3)],
    ids=["B", "D", "spring"],
)
def test_standard_deviations_match_empirical_ones_with_noise_on_angles(inertia, damping, stiffness, torque):
    """Linear springs, encoders as bad as 1 mrad: reported over empirical on 60 seeds."""
    clean, _ = planted(2500)
    t = clean[:, 0]
    rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
    bend = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
    at_stamps = inertia * bend + damping * rate - stiffness * (clean[:, 1] - clean[:, 2])
    clean[1:, 3] = 0.5 * (at_stamps[1:] + at_stamps[:-1])
    estimator = ModulatedStiffness(
        replace(
            ONE.parameters, motor_inertia_1=inertia, motor_damping_1=damping, taylor_order=0, position_noise=1e-3,
            torque_noise=torque,
        )
    )  # fmt: skip
    errors, promised = [], []
    for seed in range(60):
        rng, rows = np.random.default_rng(seed), clean.copy()
        rows[:, 1:3] += 1e-3 * rng.normal(size=(len(rows), 2))
        rows[:, 3] += torque * rng.normal(size=len(rows))
        value, sd = estimator.run_rows(rows)[1].column("stiffness")
        errors.append((value - stiffness)[1000::100])
        promised.append(sd[1000::100])
    ratio = np.sqrt(np.mean(np.square(promised)) / np.mean(np.square(errors)))
    assert 0.8 <= ratio <= 1.25, ratio


def test_deflections_never_visited_are_outside_the_range():
    rows, _ = planted()
    state, _ = ONE.run_rows(rows)
    phi = rows[:, 1] - rows[:, 2]
    for share, status in ((0.9, Status.OK), (1.2, Status.OUTSIDE_RANGE)):
        sample = rows[-1].copy()
        sample[0] += PERIOD
        sample[1] = sample[2] + share * phi.max()
        assert ONE.step(state, sample)[1].status == status


@pytest.mark.parametrize("prior", [1e6, 1e8, 1e10])
def test_standard_deviations_include_the_bias_of_a_narrow_p0(prior):
    """Stiffness of order 2 with N = 4: the bias due to P(0) is far larger than the noise."""
    rows, truth = planted(4000)
    rows[:, 3] += 1e-2 * np.random.default_rng(5).normal(size=len(rows))
    estimator = ModulatedStiffness(replace(ONE.parameters, initial_covariance=prior, taylor_order=4))
    value, sd = estimator.run_rows(rows)[1].column("stiffness_1")
    ratio = np.sqrt(np.mean(sd[2000:] ** 2) / np.mean((value - truth)[2000:] ** 2))
    assert 0.6 < ratio < 2.5
