"""Section 3's estimator: planted truths, the corrected equations in plain numpy, the printed ones, and Table 2.

Each erratum shows on a joint in prescribed motion whose torque follows from the motor equation itself.
"""

from dataclasses import replace

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
    """q, theta and the motor torque that goes with them."""
    theta = 0.3 * np.sin(7.0 * t) + 0.2 * np.sin(13.0 * t + 1.0)
    rate = 2.1 * np.cos(7.0 * t) + 2.6 * np.cos(13.0 * t + 1.0)
    acceleration = -14.7 * np.sin(7.0 * t) - 33.8 * np.sin(13.0 * t + 1.0)
    q = 0.5 * np.sin(4.0 * t)
    return q, theta, INERTIA * acceleration + DAMPING * rate - 8.0 * (q - theta) - 5.0 * (q - theta) ** 3


def planted(count=3000, jitter=0.0, begin=0.0):
    """Rows (count, 4) with the torque held over the interval that ends at its stamp, and the true stiffness."""
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
    """alpha (k, terms) by (25)-(27) and RLS on P, torque taken for a sampled curve."""
    first, second, third = weights
    phi, factorial = q - theta, 1.0
    C = fir(INERTIA * third - DAMPING * second, theta) - fir(first, tau)
    gamma = []
    for j in range(terms):
        factorial *= j + 1
        gamma.append(fir(first, phi ** (j + 1) / factorial))
    P, w, gain, found = np.empty((terms, terms)), np.empty(terms), np.empty(terms), []
    rls.start(P, w, prior)
    for v, y in zip(np.array(gamma).T, C, strict=True):
        rls.update(P, w, v.copy(), y, 1.0, gain)
        found.append(w.copy())
    return np.array(found)


def sampled(count=2000, offset=0.0, begin=0.0):
    q, theta, tau = motion(begin + PERIOD * np.arange(count))
    return q + offset, theta + offset, tau


@pytest.mark.parametrize("jitter", [0.0, 0.8])
@pytest.mark.parametrize("order", [3, 4, 5])
def test_planted_stiffness_comes_back(jitter, order):
    rows, truth = planted(jitter=jitter)
    estimator = ModulatedStiffness(replace(ONE.parameters, modulating_order=order))
    state, estimates = estimator.run_rows(rows)
    settled = estimates.status == Status.OK
    assert settled.mean() > 0.7
    assert np.abs(estimates.value[:, 0] - truth)[settled].max() < 2e-3 * truth.max()
    np.testing.assert_allclose(estimator.coefficients(state)[0], ALPHA, atol=0.02)


def test_before_a_full_window_nothing_is_taken_for_zero():
    rows, truth = planted(begin=5.0)
    _, estimates = ONE.run_rows(rows)
    assert np.all(estimates.status[: 2 * H] == Status.WARMING_UP)
    settled = estimates.status == Status.OK
    assert np.abs(estimates.value[:, 0] - truth)[settled].max() < 2e-3 * truth.max()


def test_k_below_h_filled_with_zeros_as_printed_is_right_only_from_rest():
    """A log that begins in motion: the step from zero to its first sample is taken for data, forever."""
    signals = sampled(begin=5.0)
    filled = recursion(*(np.concatenate([np.zeros(H), signal]) for signal in signals), document())[-1]
    waiting = recursion(*signals, document())[-1]
    assert np.abs(waiting - ALPHA).max() < 0.05
    assert np.abs(filled - ALPHA).max() > 2.0


def test_equal_to_rls_on_rows_in_the_document_scale_with_its_own_p0():
    """The triangular factor with the prior P(0) and RLS on P are one estimate, on the very same weights."""
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
    right, printed = (recursion(q, theta, tau, document(backwards=b))[-1] for b in (False, True))
    assert np.abs(right - ALPHA).max() < 0.05
    assert np.abs(printed - ALPHA).max() > 5.0
    # it is the D term: told -D, the printed form is right again
    second = document(backwards=True) * np.array([[1.0], [-1.0], [1.0]])
    np.testing.assert_allclose(recursion(q, theta, tau, second)[-1], right, rtol=1e-6)


def test_equation_30_as_printed_makes_ten_radians_of_offset_stiffness():
    """Both angles turned by 10 rad: nothing has changed, so nothing may change."""
    moved = sampled(offset=10.0)
    right, printed = (recursion(*moved, document(sign=sign))[-1] for sign in (-1.0, 1.0))
    assert np.abs(right - ALPHA).max() < 0.2
    assert np.abs(printed - ALPHA).max() > 100.0
    rows, _ = planted()
    offset = rows.copy()
    offset[:, 1:3] += 10.0
    np.testing.assert_allclose(ONE.run_rows(offset)[1].value, ONE.run_rows(rows)[1].value, rtol=1e-6, atol=1e-6)


def test_equations_19_to_26_hold_the_motor_torque_and_not_the_flexibility_torque():
    q, theta, tau = sampled()
    flexibility = 8.0 * (q - theta) + 5.0 * (q - theta) ** 3
    assert np.abs(recursion(q, theta, tau, document())[-1] - ALPHA).max() < 0.05
    assert np.abs(recursion(q, theta, flexibility, document())[-1] - ALPHA).max() > 5.0


def test_equation_23_is_equation_22_divided_by_the_fourth_power():
    """psi(u) = (u - t + T)^3 (t - u)^3 with u = T nu + t - T, by quadrature: T^3 as printed leaves a factor T."""
    t, T = 0.7, 0.5
    nodes, weights = np.polynomial.legendre.leggauss(30)
    nu, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    u = T * nu + t - T
    psi = np.polynomial.Polynomial.fromroots([t - T] * 3) * -np.polynomial.Polynomial.fromroots([t] * 3)
    f = np.sin(9.0 * u)
    for derivative, power in ((1, 2), (2, 1), (3, 0)):
        left = T * np.sum(weights * f * psi.deriv(derivative)(u))
        right = T**power * np.sum(weights * f * modulating(3, derivative, nu))
        assert left / T**4 == pytest.approx(right)
        assert left / T**3 != pytest.approx(right, rel=0.1)


def test_equation_24_as_printed_weakens_every_row_by_the_window_against_p0():
    """With W = T_s in place of 1/H the prior counts 1/T^2 = 25 times as much."""
    q, theta, tau = sampled()
    prior = 1e8
    right, printed = (recursion(q, theta, tau, scale * document(), prior=prior)[-1] for scale in (1.0, SPAN))
    np.testing.assert_allclose(printed, recursion(q, theta, tau, document(), prior=prior * SPAN**2)[-1], rtol=1e-8)
    assert np.abs(printed - ALPHA).max() > 3.0 * np.abs(right - ALPHA).max()


def test_deviations_are_those_seen_and_the_naive_ones_far_too_small():
    """40 runs; sigma^2 P with residuals taken for independent promises many times too much."""
    rows, truth = planted()
    estimator = ModulatedStiffness(replace(ONE.parameters, torque_noise=0.3))
    errors, deviations = [], []
    for seed in range(40):
        noisy = rows.copy()
        noisy[:, 3] += 0.3 * np.random.default_rng(seed).normal(size=len(rows))
        _, estimates = estimator.run_rows(noisy)
        errors.append((estimates.value[:, 0] - truth)[1000::50])
        deviations.append(estimates.standard_deviation[1000::50, 0])
    ratio = np.sqrt(np.mean(np.square(deviations)) / np.mean(np.square(errors)))
    assert 0.8 <= ratio <= 1.25


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
def test_deviations_tell_what_a_narrow_p0_holds_back_and_no_more(prior):
    """A law of order 2 with N = 4: P(0) holds the estimate off the truth by far more than noise does."""
    rows, truth = planted(4000)
    rows[:, 3] += 1e-2 * np.random.default_rng(5).normal(size=len(rows))
    estimator = ModulatedStiffness(replace(ONE.parameters, initial_covariance=prior, taylor_order=4))
    value, deviation = estimator.run_rows(rows)[1].column("stiffness_1")
    ratio = np.sqrt(np.mean(deviation[2000:] ** 2) / np.mean((value - truth)[2000:] ** 2))
    assert 0.6 < ratio < 2.5
