"""Errors of rounding: how those of readings near one another hang together, and what sums of readings make of them.

An encoder's error is a sawtooth of its angle, e(x) = s (x / s - rint(x / s)) with the step s. Where every phase is as
likely as another, two readings d steps apart have

    <e(x) e(x + d s)> = s^2 / 12 r(d),   r(d) = 1 - 6 f (1 - f),   f = d - floor(d)

(the integral over one tooth; a Bernoulli polynomial, as every correlation of sawtooths). An axis that crosses many
steps from reading to reading has errors without order, r averages to zero. One that stays on a step for several
readings repeats its error: their mean is no better than one of them, and slopes fitted to them are worse.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz
from scipy.signal import savgol_coeffs, savgol_filter
from via_core.signals import Array

PLACES = 2000  # of a log that are looked at
ALIKE = 0.5  # difference of two bends over their sum: one at most three times the other


def correlation(angle: Array, step: float, lags: int, run: int = 0) -> Array:
    """(lags,) mean correlation r of readings so many samples apart; `angle` (T,) [rad] as smooth as it is known.

    run  samples within which the angle must cross a step to count: an error that stays is the start's
    """
    windows = sliding_window_view(angle, min(max(lags, run), len(angle)))
    apart = windows[:: max(1, len(windows) // PLACES)] / step
    if run:
        apart = apart[np.ptp(apart, axis=1) >= 1.0]
    apart = apart[:, :lags] - apart[:, :1]
    part = apart - np.floor(apart)
    return 1.0 - 6.0 * np.mean(part * (1.0 - part), axis=0) if len(apart) else np.eye(1, lags)[0]


def variances(weights: Array, correlated: Array) -> Array:
    """Of sums of n neighbouring readings by `weights` (..., n), over that of one; `correlated` (n or more,)."""
    together = toeplitz(correlated[: weights.shape[-1]])
    return np.einsum("...i,ij,...j->...", weights, together, weights)


def variance(weights: Array, correlated: Array) -> float:
    """The same of one sum (n,)."""
    return float(variances(weights, correlated))


def mean_variance(correlated: Array) -> float:
    """Of the mean of n readings, over that of one reading: 1 / n where errors have no order, at least that."""
    count = len(correlated)
    return max(1.0 / count, variance(np.full(count, 1.0 / count), correlated))


def between(time: Array, readings: Array, wanted: Array, widest: float) -> tuple[Array, Array]:
    """Readings (N,) taken at `time`, between them at `wanted` (T,) -> (T,), and the weights (T, 4) of the four around.

    A cubic through the two to either side; beside spans wider than `widest`, at the ends, and where the bends (second
    divided differences) at the two sides are not alike, a straight line, which is wrong by span^2 / 8 times the
    acceleration. A cubic through a jump or a kink is wrong by a share of the jump.
    """
    count = len(time)
    after = np.clip(np.searchsorted(time, wanted), 1, count - 1)
    around = after[:, None] + np.arange(-2, 2)
    inner = (after >= 2) & (after <= count - 2)
    around = np.clip(around, 0, count - 1)
    nodes = time[around]
    inner &= np.all(np.diff(nodes, axis=1) <= widest, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # of nodes that stand for those beyond the ends
        slopes = np.diff(readings[around], axis=1) / np.diff(nodes, axis=1)
        bends = np.diff(slopes, axis=1) / (nodes[:, 2:] - nodes[:, :-2])
    inner &= np.abs(bends[:, 1] - bends[:, 0]) <= ALIKE * np.abs(bends[:, 1] + bends[:, 0])
    weights = np.zeros((len(wanted), 4))
    share = np.clip((wanted - nodes[:, 1]) / (nodes[:, 2] - nodes[:, 1]), 0.0, 1.0)
    weights[:, 1], weights[:, 2] = 1.0 - share, share
    x, at = wanted[inner], nodes[inner]
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weights[inner, k] = np.prod([(x - at[:, j]) / (at[:, k] - at[:, j]) for j in others], axis=0)
    return np.sum(weights * readings[around], axis=1), weights


def slope_order(readings: Array, angle: Array, step: float, window: int) -> int:
    """2 or 3: the polynomial over `window` readings whose slope in their middle is less wrong in the mean square.

    readings  (T,) [rad] evenly sampled; angle (T,) the same, smoothed

    The quadratic's slope is wrong by a bias b that the cubic has not, and by noise n2; the cubic's by n3, which is
    more. Their difference d shows the bias, <d^2> = <b^2> + <(n3 - n2)^2>, and so which of the two is better:
    the cubic where <b^2> > <n3^2> - <n2^2>.
    """
    both = [savgol_coeffs(window, order, deriv=1, use="dot") for order in (2, 3)]
    inside = slice(window // 2, len(readings) - window // 2)
    less, more = (savgol_filter(readings, window, order, deriv=1)[inside] for order in (2, 3))
    correlated = correlation(angle, step, window)
    noise = step**2 / 12.0 * np.array([variance(each, correlated) for each in (*both, both[1] - both[0])])
    bias = float(np.mean((more - less) ** 2)) - noise[2]
    return 3 if bias > noise[1] - noise[0] else 2
