"""Angles and velocities of a log by local polynomials, also where samples were lost.

Source: A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures,
Analytical Chemistry 36 (1964). Lost samples have no weight in the least squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import savgol_filter
from via_core.signals import Array, Mask

from via_gap.logs.rounding import slope_order


def smoothed(
    angles: Array, known: Mask, axes: Sequence[int], half: int, quanta: Array, per_sample: int
) -> tuple[Array, Array]:
    """(T, 6) angle of a quadratic and velocity [1/tick] of a quadratic or a cubic, over `half` ticks to either side.

    angles   (T, a); `known` (T, a): 0 where a sample was lost
    axes     0 link, 1, 2 motors; quanta (a,) steps of their encoders

    The second result (T, a) is the larger standard deviation of angle and velocity times `half`, over that of a sample.
    The slope of a quadratic has a bias of half^2 / 10 times the third derivative. In quick motion with a fine encoder,
    this is more than the noise of the cubic's slope; with a coarse encoder, the noise is larger.
    """
    window = window_of(half, len(angles))
    read = angles[::per_sample]
    among = window_of(max(2, round(half / per_sample)), len(read))
    states, sd = np.full((len(angles), 6), np.nan), np.zeros(angles.shape)
    for i, axis in enumerate(axes):
        path = savgol_filter(angles[:, i], window, 2)
        order = slope_order(read[:, i], path[::per_sample], quanta[i], among) if quanta[i] > 0.0 else 3
        if known[:, i].all():
            states[:, axis] = path
            states[:, 3 + axis] = savgol_filter(angles[:, i], window, order, deriv=1)
        else:
            states[:, axis], sd[:, i] = local_fit(angles[:, i], known[:, i], window // 2, 2, 0)
            slope, uncertain = local_fit(angles[:, i], known[:, i], window // 2, order, 1)
            states[:, 3 + axis], sd[:, i] = slope / (window // 2), np.maximum(sd[:, i], uncertain)
    return states, sd


def local_fit(values: Array, known: Mask, half: int, order: int, derivative: int) -> tuple[Array, Array]:
    """Derivative 0 or 1 (T,) by t / half of the polynomial fitted to the known values within `half` to either side.

    The second result (T,) is its standard deviation over that of a value; infinite where too few are known, where the
    first result is the value itself or 0.
    """
    at = np.arange(-half, half + 1) / half
    powers = [at**k for k in range(2 * order + 1)]

    def sums(data: Array, count: int) -> Array:
        return np.stack([np.correlate(data, powers[k], mode="same") for k in range(count)], axis=-1)

    moments = sums(known.astype(np.float64), 2 * order + 1)
    normal = moments[:, np.add.outer(np.arange(order + 1), np.arange(order + 1))]
    enough = moments[:, 0] > order
    inverse = np.linalg.inv(np.where(enough[:, None, None], normal, np.eye(order + 1)))
    found = np.einsum("tk,tk->t", inverse[:, derivative], sums(np.where(known, values, 0.0), order + 1))
    sd = np.sqrt(inverse[:, derivative, derivative])
    return np.where(enough, found, 0.0 if derivative else values), np.where(enough, sd, np.inf)


def window_of(half: int, count: int) -> int:
    """Odd number of ticks of a window with `half` ticks to either side, at most `count`."""
    return min(2 * half + 1, (count - 1) // 2 * 2 + 1)
