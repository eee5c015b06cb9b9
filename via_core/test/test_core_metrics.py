"""Metrics: values by hand, definitions, refused input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from via_core.errors import SignalError
from via_core.metrics import coverage, nrmse


def test_nrmse_is_one_for_the_mean_and_zero_for_the_signal_itself() -> None:
    measured = np.sin(np.linspace(0.0, 7.0, 100))
    assert nrmse(measured, measured) == 0.0
    assert nrmse(measured, np.full(100, measured.mean())) == pytest.approx(1.0)


@given(scale=st.floats(1e-3, 1e3), offset=st.floats(-1e3, 1e3))
def test_nrmse_is_invariant_to_unit_and_offset(scale: float, offset: float) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=50), rng.normal(size=50)
    assert nrmse(scale * a + offset, scale * b + offset) == pytest.approx(nrmse(a, b), rel=1e-6)


def test_coverage_of_gaussian_intervals() -> None:
    rng = np.random.default_rng(1)
    truth = rng.normal(size=20_000)
    sd = rng.uniform(0.5, 2.0, 20_000)
    estimate = truth + sd * rng.normal(size=20_000)
    assert coverage(truth, estimate, sd) == pytest.approx(0.9545, abs=0.006)
    assert coverage(truth, estimate, sd, width=1.0) == pytest.approx(0.6827, abs=0.012)
    assert coverage([1.0, 1.0], [1.0, 2.0], [0.0, 0.5]) == 1.0
    assert coverage([1.0, 1.0], [1.0, 2.1], [0.0, 0.5]) == 0.5


@pytest.mark.parametrize("metric", [nrmse, lambda a, b: coverage(a, b, np.ones_like(a))])
@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ([], [], "is empty"),
        ([1.0, 2.0], [1.0], r"equal length, got .* \(2,\), .* \(1,\)"),
        ([[1.0, 2.0]], [[1.0, 2.0]], "equal length"),
        (1.0, 2.0, "equal length"),
        ([1.0, np.nan], [1.0, 2.0], "not finite at sample 1"),
        ([1.0, 2.0], [np.inf, 2.0], "not finite at sample 0"),
    ],
)
def test_empty_data_is_refused(metric, a, b, message: str) -> None:
    with pytest.raises(SignalError, match=message):
        metric(a, b)


def test_a_zero_reference_is_refused() -> None:
    with pytest.raises(SignalError, match="constant"):
        nrmse([2.0, 2.0], [1.0, 3.0])
    with pytest.raises(SignalError, match="negative at sample 0"):
        coverage([1.0], [1.0], [-1.0])
    with pytest.raises(SignalError, match="width must be > 0"):
        coverage([1.0], [1.0], [1.0], width=0.0)
