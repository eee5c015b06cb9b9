"""Gaussian estimates in place: mean x (n,) and covariance P (n, n), their mixture and correction.

Loops run along rows of P, so that they are compiled to vector instructions. P stays symmetric to the last bit, since
each product with i and k has the same bits with k and i.
"""

from __future__ import annotations

from numba import njit
from via_core.signals import Array


@njit(cache=True, error_model="numpy")
def quadratic(P: Array, v: Array) -> float:
    """v' P v of P (n, n), v (n,), at least 0."""
    total = 0.0
    for i in range(v.size):
        row = 0.0
        for j in range(v.size):
            row += P[i, j] * v[j]
        total += v[i] * row
    return max(total, 0.0)


@njit(cache=True, error_model="numpy")
def mix(x: Array, P: Array, weight: float, other: Array, cover: Array) -> None:
    """Replace x (n,), P (n, n) by the mean and covariance of their mixture with other, cover, which has `weight`."""
    n, own = x.size, 1.0 - weight
    for i in range(n):
        for k in range(n):
            apart = (other[i] - x[i]) * (other[k] - x[k])
            P[i, k] = own * P[i, k] + weight * (cover[i, k] + own * apart)
    for i in range(n):
        x[i] = own * x[i] + weight * other[i]


@njit(cache=True, error_model="numpy", inline="always")
def times(P: Array, row: Array, product: Array) -> None:
    """Write P row of a symmetric P (n, n) into product (n,)."""
    product[:] = 0.0
    n = row.size
    for k in range(n):
        factor = row[k]
        for i in range(n):
            product[i] += factor * P[k, i]


@njit(cache=True, error_model="numpy")
def correct(
    x: Array, P: Array, row: Array, innovation: float, variance: float, error: float, ahead: Array, left: Array
) -> None:  # fmt: skip
    """Add an equation y = row' x + e by Kalman's gain, P <- (1 - gain row') P (1 - row gain') + error gain gain'.

    innovation       y - row' x
    variance, error  that of the innovation, and that of e
    ahead            (n,) P row, overwritten by the gain
    left             (n,) overwritten
    """
    n, per = x.size, 1.0 / variance
    for i in range(n):
        own = ahead[i]
        x[i] += own * per * innovation
        for k in range(n):
            P[i, k] -= own * ahead[k] * per
    times(P, row, left)
    for i in range(n):
        ahead[i] *= per
        left[i] = 0.5 * (error * ahead[i] - left[i])
    for i in range(n):
        own, other = ahead[i], left[i]
        for k in range(n):
            P[i, k] += other * ahead[k] + left[k] * own
