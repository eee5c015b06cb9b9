"""Recursive least squares on the covariance matrix P, plain and with the document's stability factor.

Source: SAPHARI deliverable, eqs. (66)-(70), and (71)-(73) for the factor c. With r = v' P v and e = y - v' w,

    alpha = c (1 + r) / (1 + c r),   w <- w + alpha k e,   P <- P - alpha k v' P,   k = P v / (1 + r),

so that alpha k = P v c / (1 + c r). c = 1 is plain least squares, bit by bit. Any other c is plain least squares with c
P(0) in place of P(0): (73), proposed there against poor excitation, has no such effect.

The document's baselines use this recursion. VIA's own estimators use the triangular root of P^-1 instead (`qr`), which
rounding cannot make indefinite. Here P (n x n, not m x m as printed) is computed once and mirrored, so it is symmetric
by construction.
"""

from __future__ import annotations

from numba import njit
from via_core.signals import Array


@njit(cache=True, error_model="numpy")
def start(P: Array, w: Array, prior: float) -> None:
    """Overwrite with the start of the recursion: w (n,) = 0 and P (n, n) = prior times the unit matrix."""
    P[:, :] = 0.0
    w[:] = 0.0
    for j in range(w.size):
        P[j, j] = prior


@njit(cache=True, error_model="numpy")
def update(P: Array, w: Array, v: Array, y: float, c: float, gain: Array) -> float:
    """Add the equation v' w = y to w (n,) and P (n, n), both overwritten; returns the innovation e of (66).

    v     (n,) regressors
    c     stability factor > 0 of (73); 1 is plain
    gain  (n,) overwritten with the gain alpha k; allocated by the caller for speed
    """
    n = w.size
    innovation, r = y, 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * v[j]
        gain[i] = total
        r += v[i] * total
        innovation -= v[i] * w[i]
    share = c / (1.0 + c * r)
    for i in range(n):
        part = share * gain[i]
        for j in range(i, n):
            P[i, j] -= part * gain[j]
            P[j, i] = P[i, j]
        gain[i] = part
        w[i] += part * innovation
    return innovation
