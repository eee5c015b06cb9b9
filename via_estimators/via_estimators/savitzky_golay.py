"""Savitzky-Golay smoothing of any order: value and slope at the centre of a window, in an orthogonal basis.

Source: SAPHARI deliverable, Section 4.3: a polynomial of degree 20 over W = 1000 samples is fitted by least squares and
evaluated at the window's centre. A window with a centre has an odd number of samples: 1001, and the delay is (W - 1)/2
Ts.

Departure: a fit of degree 20 in powers exceeds the precision of float64; scipy.signal.savgol_filter then returns nearly
zero without a warning. Here the basis is that of Gram, the polynomials orthogonal on the samples themselves, by their
three-term recurrence on [-1, 1]:

    p_(k+1)(u) = u p_k(u) - b_k p_(k-1)(u),   b_k = |p_k|^2 / |p_(k-1)|^2,   value = sum_k p_k(0) p_k / |p_k|^2

There are no other terms on symmetric samples. Even k contribute to the value, odd k to the slope p_k'(0).
"""

from __future__ import annotations

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array


def savitzky_golay(window: int, order: int, interval: float = 1.0) -> tuple[Array, Array]:
    """Weights (W,), oldest first, whose inner products with W samples are value and slope at the centre sample.

    window    W, odd, > order
    order     degree of the polynomial, >= 1
    interval  [s] between samples; the slope's weights are per that unit

    Raises ParameterError for an even window, an order too high for it, or an interval that is not > 0.
    """
    if window % 2 == 0:
        raise ParameterError(f"a window with a centre has an odd number of samples, got {window}")
    if not 1 <= order < window:
        raise ParameterError(f"order must be 1 to {window - 1} in a window of {window}, got {order}")
    if not (np.isfinite(interval) and interval > 0.0):
        raise ParameterError(f"interval must be finite and > 0 s, got {interval}")
    half = window // 2
    u = np.arange(-half, half + 1) / half
    before, here = np.zeros(window), np.full(window, 1.0 / np.sqrt(window))
    slope_before, slope = 0.0, 0.0  # p_k'(0)
    value_weights, slope_weights = np.zeros(window), np.zeros(window)
    step = 0.0  # norm in the last recurrence
    for _ in range(order + 1):
        value_weights += here[half] * here
        slope_weights += slope * here
        ahead = u * here - step * before
        ahead -= here * (here @ ahead) + before * (before @ ahead)  # reorthogonalisation
        slope_ahead = here[half] - step * slope_before
        step = float(np.linalg.norm(ahead))
        if step == 0.0:
            break
        before, here = here, ahead / step
        slope_before, slope = slope, slope_ahead / step
    return value_weights, slope_weights / (half * interval)
