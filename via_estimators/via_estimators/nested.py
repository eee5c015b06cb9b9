"""An estimate that allows for a simpler model: some unknown may have a stated value, such as an effect that is absent.

A Gaussian estimate x, P of a model with prior x_j ~ N(0, 1) contains the simpler model x_j = a. Its evidence against
the whole one is the ratio of the densities of x_j = a after and before the data (Dickey, The weighted likelihood ratio,
Annals of Mathematical Statistics 42, 1971):

    log K = -(x_j - a)^2 / (2 P_jj) + a^2 / 2 - log(P_jj) / 2

With odds o before, it has the probability o K / (1 + o K); its estimate is that of x given x_j = a, and mean and
covariance are those of the mixture of both. So an unknown costs accuracy only where the data show its effect.

Of many effects, some would be found by chance if each had even odds. `odds_of` gives each the odds by which half of the
probability is that of no effect at all (Scott, Berger, Bayes and empirical-Bayes multiplicity adjustment in the
variable-selection problem, Annals of Statistics 38, 2010).
"""

from __future__ import annotations

from math import exp, log

from numba import njit
from via_core.signals import Array

LARGEST = 500.0  # of |log K|, whose exponential is finite


def odds_of(effects: int) -> float:
    """Odds that one effect is absent, if all are absent with probability 1/2."""
    return 1.0 / (2.0 ** (1.0 / effects) - 1.0)


@njit(cache=True, error_model="numpy")
def allow(x: Array, P: Array, j: int, a: float, odds: float) -> None:
    """Replace mean x (n,) and covariance P (n, n) by those of the mixture with the model x_j = a, of those odds."""
    n, variance = x.size, P[j, j]
    if not variance > 0.0:
        return
    off = a - x[j]
    evidence = log(odds) + 0.5 * (a * a - off * off / variance - log(variance))
    simpler = 1.0 / (1.0 + exp(-min(max(evidence, -LARGEST), LARGEST)))
    # P <- P - simpler g g' / variance + simpler (1 - simpler) shift shift', shift = g off / variance, g = P_j
    share = simpler * ((1.0 - simpler) * off * off / variance - 1.0) / variance
    column = P[:, j].copy()
    for i in range(n):
        x[i] += simpler * column[i] * off / variance
        for k in range(n):
            P[i, k] += share * column[i] * column[k]
