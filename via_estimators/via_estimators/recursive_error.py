"""Covariance of a recursive estimate w <- w + k e under coloured noise, for any gain k.

The error e_w = w - w* of an estimate w <- w + k (y - v' w) with y = v' w* + xi obeys, for any k,

    e_w <- A e_w + k xi,   A = I - k v'.

Forgetting, variable factors and corrections are all part of k, so P of a recursion is not the covariance of e_w. If
neighbouring xi are correlated, E[xi_i xi_(i-d)] = s^2 r_d, because each is a filter over the same samples,

    C <- A C A' + r_0 k k' + A X k' + k X' A',   X = sum_d r_d g_(i-d),   g_j <- A g_j, g_i = k

is exact for s = 1: C is the sandwich of `coloured`, for gains other than those of least squares. The covariance of the
prior's error has its own recursion, Q <- A Q A', in physical units; the total is s^2 C + Q. One innovation has the
variance s^2 (r_0 + v' C v - 2 v' X) + v' Q v, from which s^2 is measured.

A w* that changes by dw per row causes a bias with the same recursion, b <- A (b + dw) (`bias`).
"""

from __future__ import annotations

from numba import njit
from via_core.signals import Array

from via_estimators.coloured import dot


@njit(cache=True, error_model="numpy")
def quadratic(M: Array, v: Array) -> float:
    """v' M v for M (n, n), v (n,)."""
    total = 0.0
    for i in range(v.size):
        for j in range(v.size):
            total += v[i] * M[i, j] * v[j]
    return total


@njit(cache=True, error_model="numpy")
def expected(C: Array, G: Array, v: Array, lagged: Array, X: Array) -> float:
    """Variance of the coming innovation for s = 1 and a known prior; X (n,) is overwritten with E[e_w xi] / s^2.

    C       (n, n)
    G       (n, L) the gains g by ring slot
    v       (n,) regressors of the coming row
    lagged  (L,) autocorrelation by ring slot, r_0 / 2 in the slot of the coming row
    """
    total = quadratic(C, v)
    for j in range(v.size):
        X[j] = dot(G[j], lagged)
        total -= 2.0 * v[j] * X[j]
    return total


@njit(cache=True, error_model="numpy")
def follow(C: Array, Q: Array, G: Array, slot: int, k: Array, v: Array, X: Array, r0: float, row: Array) -> None:
    """One step of C and Q (n, n) and of the ring G (n, L), all overwritten; the slot of the coming row must be zero.

    k, v  (n,) gain and regressors
    X     (n,) as `expected` left it
    r0    variance of one xi for s = 1
    row   (n,) overwritten
    """
    n = v.size
    _through(Q, k, v, row)
    _through(C, k, v, row)
    along = 0.0
    for j in range(n):
        along += v[j] * X[j]
    for i in range(n):
        for j in range(n):
            C[i, j] += r0 * k[i] * k[j] + (X[i] - k[i] * along) * k[j] + k[i] * (X[j] - k[j] * along)
    for m in range(G.shape[1]):
        along = 0.0
        for j in range(n):
            along += v[j] * G[j, m]
        for j in range(n):
            G[j, m] -= k[j] * along
    for j in range(n):
        G[j, slot] = k[j]


@njit(cache=True, error_model="numpy")
def bias(b: Array, k: Array, v: Array) -> None:
    """b <- A b, b (n,) overwritten."""
    along = 0.0
    for j in range(v.size):
        along += v[j] * b[j]
    for j in range(v.size):
        b[j] -= k[j] * along


@njit(cache=True, error_model="numpy")
def _through(M: Array, k: Array, v: Array, row: Array) -> None:
    """M <- A M A', A = I - k v', for symmetric M (n, n)."""
    n = v.size
    total = 0.0
    for i in range(n):
        row[i] = 0.0
        for j in range(n):
            row[i] += M[i, j] * v[j]
        total += v[i] * row[i]
    for i in range(n):
        for j in range(i, n):
            M[i, j] += total * k[i] * k[j] - k[i] * row[j] - row[i] * k[j]
            M[j, i] = M[i, j]
