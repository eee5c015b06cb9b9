"""Steps of encoders and their rounding errors: correlation of neighbours, and variance of weighted sums.

An encoder's error is a sawtooth of its angle, e(x) = s (x / s - rint(x / s)) with the step s. If every phase is equally
likely, the errors of two measurements d steps apart have

    <e(x) e(x + d s)> = s^2 / 12 r(d),   r(d) = 1 - 6 f (1 - f),   f = d - floor(d)

(the integral over one tooth, a Bernoulli polynomial). If an axis crosses many steps between measurements, r averages to
zero, and errors are uncorrelated. If it stays on a step for several measurements, they have the same error: their mean
is no better than one of them, and slopes fitted to them are worse.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz
from scipy.signal import savgol_coeffs, savgol_filter
from via_core.signals import Array

PLACES = 2000  # windows of a log that are used at most
ALIKE = 0.5  # difference of two curvatures over their sum: one at most three times the other


def distances(angle: Array, step: float, lags: int, run: int = 0) -> Array:
    """(places, lags) steps from one measurement to the next ones, at some places of a log; `angle` (T,) [rad] smoothed.

    run  samples within which the angle must cross a step: a constant error is attributed to the start. 0: no condition
    """
    windows = sliding_window_view(angle, min(max(lags, run), len(angle)))
    windows = windows[:: max(1, len(windows) // PLACES)] / step
    if run:
        windows = windows[np.ptp(windows, axis=1) >= 1.0]
    return windows[:, :lags] - windows[:, :1]


def correlation(angle: Array, step: float, lags: int, run: int = 0) -> Array:
    """(lags,) mean correlation r of the errors of two measurements at each lag; arguments as of `distances`."""
    apart = distances(angle, step, lags, run)
    part = apart - np.floor(apart)
    return 1.0 - 6.0 * np.mean(part * (1.0 - part), axis=0) if len(apart) else np.eye(1, lags)[0]


def variances(weights: Array, correlated: Array) -> Array:
    """Variances of sums of neighbouring errors with `weights` (..., n), over that of one; `correlated` (n or more,)."""
    together = toeplitz(correlated[: weights.shape[-1]])
    return np.einsum("...i,ij,...j->...", weights, together, weights)


def mean_variance(correlated: Array) -> float:
    """Variance of the mean of n errors, over that of one, at least 1 / n; `correlated` (n,)."""
    count = len(correlated)
    return max(1.0 / count, float(variances(np.full(count, 1.0 / count), correlated)))


def interpolated(time: Array, values: Array, wanted: Array, widest: float) -> tuple[Array, Array]:
    """Values (N,) at `time`, interpolated at `wanted` (T,) -> (T,), and weights (T, 4) of the four neighbours.

    A cubic through two neighbours to either side. Beside gaps wider than `widest`, at the ends, and where curvatures
    (second divided differences) on both sides are not alike, linear interpolation, whose error is span^2 / 8 times the
    acceleration. The error of a cubic through a jump or a kink is proportional to the jump.
    """
    count = len(time)
    after = np.clip(np.searchsorted(time, wanted), 1, count - 1)
    around = after[:, None] + np.arange(-2, 2)
    inner = (after >= 2) & (after <= count - 2)
    around = np.clip(around, 0, count - 1)
    nodes = time[around]
    inner &= np.all(np.diff(nodes, axis=1) <= widest, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # nodes beyond the ends are repeated
        slopes = np.diff(values[around], axis=1) / np.diff(nodes, axis=1)
        bends = np.diff(slopes, axis=1) / (nodes[:, 2:] - nodes[:, :-2])
    inner &= np.abs(bends[:, 1] - bends[:, 0]) <= ALIKE * np.abs(bends[:, 1] + bends[:, 0])
    weights = np.zeros((len(wanted), 4))
    share = np.clip((wanted - nodes[:, 1]) / (nodes[:, 2] - nodes[:, 1]), 0.0, 1.0)
    weights[:, 1], weights[:, 2] = 1.0 - share, share
    x, at = wanted[inner], nodes[inner]
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weights[inner, k] = np.prod([(x - at[:, j]) / (at[:, k] - at[:, j]) for j in others], axis=0)
    return np.sum(weights * values[around], axis=1), weights


def slope_order(values: Array, angle: Array, step: float, window: int) -> int:
    """2 or 3: degree of the polynomial over `window` samples with the smaller mean squared error of the slope.

    values  (T,) [rad] evenly sampled; angle (T,) the same, smoothed

    The slope of the quadratic has a bias b and noise n2, that of the cubic no bias and more noise n3. The bias follows
    from their difference d, <d^2> = <b^2> + <(n3 - n2)^2>. The cubic is better if <b^2> > <n3^2> - <n2^2>.
    """
    both = [savgol_coeffs(window, order, deriv=1, use="dot") for order in (2, 3)]
    inside = slice(window // 2, len(values) - window // 2)
    less, more = (savgol_filter(values, window, order, deriv=1)[inside] for order in (2, 3))
    correlated = correlation(angle, step, window)
    noise = step**2 / 12.0 * np.array([variances(each, correlated) for each in (*both, both[1] - both[0])])
    bias = float(np.mean((more - less) ** 2)) - noise[2]
    return 3 if bias > noise[1] - noise[0] else 2
