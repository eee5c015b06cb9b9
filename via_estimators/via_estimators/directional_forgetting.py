"""Exponential and directional forgetting with a variable factor and covariance correction, stable at standstill.

Source: SAPHARI deliverable, Section 5.1, Algorithm 1: eqs. (66)-(69), (75)-(79). With r = v' P v,

    k = P v / (1 + r),   w <- w + k e,   P <- P - P v v' P / (1/beta + r) + delta I,   beta = lambda - (1 - lambda) / r.

As printed, the recursion fails at standstill: beta overflows as r falls, P becomes indefinite within seconds, and delta
I accumulates without bound in directions without excitation. Three departures, without effect under excitation:

  - beta is eliminated: P <- P - (lambda r - (1 - lambda)) / (lambda r (1 + r)) P v v' P, which along v leaves
    r / (lambda (1 + r)) of r, finite and positive however small r is. P is carried as its triangular root, P = R' R, so
    it is positive semidefinite by construction and rounding cannot change that;
  - delta decreases as P grows, for each direction, P_jj += delta max(0, 1 - P_jj / p_max), so that one without
    excitation does not stop the growth of the others; a full P (trace P >= n p_max) forgets no more. Hence always
    trace P <= n (p_max / lambda_min + p_max + delta);
  - eta of (79) has a lower bound, without which (78) is 0/0 on the first row at rest.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators.qr import rotate_in

LEAST = 1e-200  # rows with r below this are skipped, since its reciprocal would overflow


@njit(cache=True, error_model="numpy")
def forgetting_factor(error: float, energy: float, sensitivity: float, least: float) -> float:
    """lambda of (77)-(78): 1 while the error is small beside its recent energy, down to `least` where it grows.

    error        e, a priori [N m]
    energy       eta of (79), floor included, > 0 [(N m)^2]
    sensitivity  rho [-]
    least        lambda_min [-]
    """
    halvings = float(round(sensitivity * error * error / energy))
    return least + (1.0 - least) * 2.0**-halvings


@njit(cache=True, error_model="numpy")
def trace(R: Array) -> float:
    """trace P of P = R' R, R (n, n)."""
    total = 0.0
    for i in range(R.shape[0]):
        for j in range(i, R.shape[0]):
            total += R[i, j] * R[i, j]
    return total


@njit(cache=True, error_model="numpy")
def grow(R: Array, correction: float, limit: float, row: Array, spare: Array) -> None:
    """P_jj += delta max(0, 1 - P_jj / p_max) for every j, by rotations.

    R            (n, n) upper triangular, overwritten
    correction   delta [1/(rad/s)^2]
    limit        p_max [1/(rad/s)^2]
    row, spare   (n,) overwritten with zeros
    """
    n = row.size
    for j in range(n):
        diagonal = 0.0
        for i in range(j + 1):
            diagonal += R[i, j] * R[i, j]
        each = correction * (1.0 - diagonal / limit)
        if each > 0.0:
            row[j] = sqrt(each)
            rotate_in(R, spare, row, 0.0, j)


@njit(cache=True, error_model="numpy")
def update(R: Array, v: Array, keep: float, limit: float, gain: Array, row: Array, spare: Array) -> None:
    """The gain k of (68) for P = R' R, then P of (75) without delta I; both overwritten.

    R           (n, n) upper triangular
    v           (n,) regressors
    keep        lambda; 1 is used instead while P is full
    limit       p_max [1/(rad/s)^2]
    gain        (n,) k
    row, spare  (n,) overwritten with zeros
    """
    n = v.size
    f = spare
    r = 0.0
    for i in range(n):
        f[i] = 0.0
        for j in range(i, n):
            f[i] += R[i, j] * v[j]
        r += f[i] * f[i]
    if r < LEAST:
        gain[:] = 0.0
        spare[:] = 0.0
        return
    if trace(R) >= n * limit:
        keep = 1.0
    for j in range(n):
        gain[j] = 0.0
        for i in range(j + 1):
            gain[j] += R[i, j] * f[i]
    # I - c f f' with c = (lambda r - (1 - lambda)) / (lambda r (1 + r)) is the square of I - share f f'.
    share = (1.0 - 1.0 / sqrt(keep * (1.0 + r))) / r
    _deflate(R, f, share, gain, row)
    spare[:] = 0.0
    for j in range(n):
        gain[j] /= 1.0 + r


@njit(cache=True, error_model="numpy")
def _deflate(R: Array, f: Array, share: float, Pv: Array, row: Array) -> None:
    """R <- triangular root of R' (I - share f f')^2 R; Pv = R' f."""
    n = f.size
    new, right = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        for j in range(n):
            row[j] = (R[i, j] if j >= i else 0.0) - share * f[i] * Pv[j]
        rotate_in(new, right, row, 0.0, 0)
    R[:, :] = new
