"""Savitzky-Golay weights: closed forms, scipy at low orders, and the order at which scipy fails."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_coeffs, savgol_filter
from via_core.errors import ParameterError
from via_estimators.savitzky_golay import savitzky_golay


def test_five_points_are_those_of_the_tables():
    value, slope = savitzky_golay(5, 2)
    np.testing.assert_allclose(value, np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35.0, atol=1e-15)
    np.testing.assert_allclose(slope, np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / 10.0, atol=1e-15)


@pytest.mark.parametrize(("window", "order"), [(5, 2), (31, 4), (51, 7), (101, 5)])
def test_equal_to_scipy_at_low_orders(window, order):
    value, slope = savitzky_golay(window, order, 2e-3)
    np.testing.assert_allclose(value, savgol_coeffs(window, order), atol=1e-9)
    np.testing.assert_allclose(slope, savgol_coeffs(window, order, deriv=1, delta=2e-3, use="dot"), atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(half=st.integers(2, 300), order=st.integers(1, 20), seed=st.integers(0, 2**32 - 1))
def test_polynomials_up_to_the_order_are_recovered_with_their_slope(half, order, seed):
    order = min(order, 2 * half)
    value, slope = savitzky_golay(2 * half + 1, order)
    u = np.arange(-half, half + 1) / half
    c = np.random.default_rng(seed).normal(size=order + 1)
    samples = np.polynomial.chebyshev.chebval(u, c)
    truth = np.polynomial.chebyshev.Chebyshev(c)
    size = np.abs(c).sum()
    assert value @ samples == pytest.approx(truth(0.0), abs=1e-11 * size)
    assert half * (slope @ samples) == pytest.approx(truth.deriv()(0.0), abs=1e-9 * size)


def test_errata_section_4_4_order_20_over_1001_samples():
    """A constant must be preserved; scipy returns almost zero, and the printed W = 1000 has no centre."""
    value, slope = savitzky_golay(1001, 20)
    assert value.sum() == pytest.approx(1.0, abs=1e-12) and abs(slope.sum()) < 1e-12
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert abs(savgol_filter(np.ones(1501), 1001, 20)[750]) < 1e-6
    with pytest.raises(ParameterError, match="odd number of samples, got 1000"):
        savitzky_golay(1000, 20)


def test_errata_53_to_55_the_delay_is_half_of_one_less_than_the_window():
    """For a ramp k Ts the filter returns the value (W - 1)/2 samples ago, not W/2."""
    window = 21
    value, _ = savitzky_golay(window, 4)
    ramp = np.arange(100.0)
    shown = value @ ramp[100 - window :]
    assert ramp[-1] - shown == pytest.approx((window - 1) / 2, abs=1e-10)
    assert abs(ramp[-1] - shown - window / 2) > 0.4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((11, 11), "order must be 1 to 10"),
        ((11, 0), "order must be 1"),
        ((11, 2, 0.0), "interval"),
        ((11, 2, np.nan), "interval"),
    ],
)
def test_invalid_arguments_raise(arguments, message):
    with pytest.raises(ParameterError, match=message):
        savitzky_golay(*arguments)
