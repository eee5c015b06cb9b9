"""An estimate restricted to joints whose parts dissipate energy: their unknowns are not negative.

A controller that holds a motor at an angle makes its torque a function of that angle and speed. Then a motor with
negative friction and damping and no spring at all, which is the controller itself, explains the motion nearly as well
as the joint does; only the signs say which of the two it is.

The mean x of a Gaussian estimate x, P is replaced by that of its part with x_j >= a_j, one unknown after the other,
first that which is furthest below its limit (Simon, Simon, Constrained Kalman filtering via density function truncation
for turbofan engine health estimation, International Journal of Systems Science 41, 2010). With s^2 = P_jj,
b = (x_j - a_j) / s and the ratio r = phi(b) / Phi(b) of density and distribution of N(0, 1):

    x_j' = x_j + s r,   P_jj' = s^2 (1 - r (r + b)),   the other unknowns follow by their correlation with x_j

Departures: P is P' only for the next unknown, and the estimate keeps its covariance. An unknown is below its limit by
chance, or because the equation lacks an effect; then its limit makes the others better, but not more certain. They are
even less certain than P says: P is to be multiplied by the mean of b^2 over all n unknowns, in which each that is not
below its limit counts as 1 (Birge's ratio), if that is more than 1.
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt

import numpy as np
from numba import njit
from via_core.signals import Array

FAR = -5.0  # below which the ratio is a continued fraction, since Phi has no digits left


@njit(cache=True, error_model="numpy")
def ratio(b: float) -> float:
    """phi(b) / Phi(b) of the standard normal distribution."""
    if b < FAR:
        t = -b
        return t + 1.0 / (t + 2.0 / (t + 3.0 / (t + 4.0 / (t + 5.0 / t))))
    return sqrt(2.0 / pi) * exp(-0.5 * b * b) / erfc(-b / sqrt(2.0))


@njit(cache=True, error_model="numpy")
def restrict(x: Array, covariance: Array, least: Array) -> float:
    """Replace mean x (n,) by that of x >= least (n,), which is -inf without a limit.

    Returns the factor by which the covariance (n, n) is too small; it is not changed.
    """
    n, count, below, P = x.size, 0, 0.0, covariance.copy()
    left = np.isfinite(least)
    while True:
        worst, b = -1, np.inf
        for j in range(n):
            if left[j] and P[j, j] > 0.0 and (x[j] - least[j]) / sqrt(P[j, j]) < b:
                worst, b = j, (x[j] - least[j]) / sqrt(P[j, j])
        if worst < 0:
            break
        left[worst] = False
        if b < 0.0:
            count, below = count + 1, below + b * b
        r, column = ratio(b), P[:, worst] / sqrt(P[worst, worst])
        for i in range(n):
            x[i] += column[i] * r
            for k in range(n):
                P[i, k] -= r * (r + b) * column[i] * column[k]
    return 1.0 + max(below - count, 0.0) / n
