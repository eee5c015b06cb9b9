"""Errors of one row: Monte Carlo, the rows of a true joint, closed forms, and what was printed instead."""

import numpy as np
import pytest
from scipy.special import beta
from via_core.errors import ParameterError
from via_core.springs import CubicSpring, SinhSpring
from via_core.weak_form import modulating
from via_validation.tables import modulating_errors as errors

H, SPAN = 500, 0.5
SINH = SinhSpring(2.0, 0.5, 3.0)  # 0.5 sinh(3 phi)


@pytest.mark.parametrize("order", [3, 5])
def test_noise_of_a_row_is_what_monte_carlo_sees(order):
    u = np.arange(H + 1) / H
    kernel = SPAN**2 / H * modulating(order, 1, u)  # vanishes at both ends, where it would be halved
    noise = 0.7 * np.random.default_rng(1).normal(size=(4000, H + 1))
    assert np.var(noise @ kernel) == pytest.approx(errors.noise_variance(0.7, H, SPAN, order), rel=0.06)


@pytest.mark.parametrize("order", [1, 3, 5])
def test_noise_tends_to_its_closed_form(order):
    """s^2 T^3 Ts h^2 (B(2h-1, 2h-1) - 4 B(2h, 2h))."""
    integral = order**2 * (beta(2 * order - 1, 2 * order - 1) - 4.0 * beta(2 * order, 2 * order))
    period = SPAN / 4000
    assert errors.noise_variance(0.3, 4000, SPAN, order) == pytest.approx(
        0.3**2 * SPAN**3 * period * integral, rel=1e-3
    )


def test_table_1_noise_grows_with_the_sampling_period_and_falls_with_the_window():
    """Printed: 'Ts up, noise down'."""
    by_period = [errors.noise_deviation(1.0, round(SPAN / period), SPAN) for period in (1e-3, 2e-3, 5e-3, 1e-2)]
    assert np.all(np.diff(by_period) > 0.0)
    assert by_period[3] / by_period[0] == pytest.approx(np.sqrt(10.0), rel=1e-3)
    by_window = [errors.noise_deviation(1.0, round(span / 1e-3), span) for span in (0.1, 0.5, 2.0)]
    assert by_window[0] / by_window[1] == pytest.approx(5.0**1.5, rel=1e-2)
    assert by_window[1] / by_window[2] == pytest.approx(4.0**1.5, rel=1e-2)


def clean_row_errors(spring, alpha, phi_of, count=1500, period=1e-3):
    """A' Gamma - C of (25)-(27) on a joint with a massless, frictionless motor: tau = -tau_e(phi)."""
    size = round(SPAN / period)
    phi = phi_of(period * np.arange(count))
    u = np.arange(size + 1) / size
    weights = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size * SPAN**2 * modulating(3, 1, u)
    fir = [np.convolve(f, weights[::-1], "valid") for f in (phi, phi**2 / 2.0, phi**3 / 6.0, -spring.torque(phi))]
    return fir[0] * alpha[0] + fir[1] * alpha[1] + fir[2] * alpha[2] + fir[3], phi


def test_truncation_is_what_is_missing_in_the_rows_of_a_true_joint_and_stays_within_its_bound():
    alpha = (1.5, 0.0, 13.5)  # Taylor of 1.5 cosh(3 phi), N = 2
    found, phi = clean_row_errors(SINH, alpha, lambda t: 0.2 + 0.8 * np.sin(5.0 * t))
    rho = errors.remainder(SINH, alpha, phi)
    predicted = errors.truncation_errors(rho, H, SPAN)
    np.testing.assert_allclose(found, predicted, atol=1e-12)
    bound = errors.truncation_bound(np.abs(rho).max(), SPAN)
    assert 0.1 * bound < np.abs(found).max() <= bound
    # (32) as printed takes sigma - sigma_N for its integral
    excess = SINH.stiffness(phi) - (alpha[0] + alpha[2] * phi**2 / 2.0)
    printed = errors.truncation_errors(excess, H, SPAN)
    assert np.abs(printed - found).max() > np.abs(found).max()


def test_samples_k_minus_m_turn_the_sign_of_what_truncation_does():
    """(32), (34) as printed pair sample k - m with m/H: the same size, the other way round."""
    phi = 0.2 + 0.8 * np.sin(5.0 * 1e-3 * np.arange(1500))
    rho = errors.remainder(SINH, [1.5, 0.0, 13.5], phi)
    found = errors.truncation_errors(rho, H, SPAN)
    backwards = SPAN**2 / H * modulating(3, 1, np.arange(H + 1) / H)[::-1]
    printed = np.convolve(rho, -backwards[::-1], "valid")
    np.testing.assert_allclose(printed, -found, atol=1e-9 * np.abs(found).max())


def test_the_bound_is_reached_by_a_step_and_the_printed_one_broken_by_slow_motion():
    """(33) prints T 5/8 sup |sigma - sigma_N|: another unit. phi jumps from -1 to 1 in the middle of 100 s."""
    spring, span, intervals = CubicSpring(2.0, 1.0), 100.0, 1000
    phi = np.where(np.arange(intervals + 1) < intervals // 2, -1.0, 1.0)
    rho = errors.remainder(spring, [0.0], phi)  # N = 0: all of phi^3
    found = np.abs(errors.truncation_errors(rho, intervals, span)).max()
    assert found == pytest.approx(errors.truncation_bound(1.0, span), rel=1e-2)
    assert errors.truncation_bound(1.0, span) == pytest.approx(span**2 / 32.0)
    assert found > 1.5 * span * 5.0 / 8.0 * np.abs(spring.stiffness(phi)).max()


def test_table_1_truncation_falls_with_the_order_of_the_polynomial():
    phi = 0.9 * np.sin(5.0 * 1e-3 * np.arange(1500))
    taylor = [1.5, 0.0, 13.5, 0.0, 121.5]
    sizes = [
        np.abs(errors.truncation_errors(errors.remainder(SINH, taylor[: n + 1], phi), H, SPAN)).max() for n in (0, 2, 4)
    ]
    assert sizes[0] > 3.0 * sizes[1] > 9.0 * sizes[2]


def test_row_scale_turns_a_row_into_a_mean_rate():
    """phi = v t: <d phi/dt> = v, so gamma_0 is -T^3 / c_h v."""
    u = np.arange(H + 1) / H
    gamma = SPAN**2 / H * np.sum(modulating(3, 1, u) * 3.0 * SPAN * u)
    assert gamma == pytest.approx(-3.0 * errors.row_scale(SPAN), rel=1e-6)


def test_misuse_is_refused():
    with pytest.raises(ParameterError, match="span must be finite and > 0 s, got 0"):
        errors.truncation_bound(1.0, 0.0)
    with pytest.raises(ParameterError, match="order must be >= 1"):
        errors.row_scale(1.0, 0)
    with pytest.raises(ParameterError, match="at least 2 intervals"):
        errors.noise_variance(1.0, 1, 1.0)
    with pytest.raises(ParameterError, match="more than 500 samples"):
        errors.truncation_errors(np.zeros(500), 500, 0.5)
