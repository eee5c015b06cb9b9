"""Change of the gap: the residual of the equations now against that of the motion that was diagnosed.

A level is the logarithm of the mean squared residual of one segment of motion. Without a change, the levels
y_1, .., y_m now and x_1, .., x_n of the diagnosed motion have one mean, and

    t = (mean(y) - mean(x)) / (s (C_m / m + C_n / n)^(1/2)),    C_k = 1 + 2 sum_l (1 - l / k) max(r_l, 0)

has Student's distribution with n / C_n - 1 degrees of freedom, where s is the standard deviation of x and r_l its
correlation at lag l: levels of neighbouring segments are alike, because the motion is.
Source: t statistic of two samples with the variance of the mean of correlated samples, G. V. Bayley and J. M.
Hammersley, The 'effective' number of independent observations in an autocorrelated time series, 1946.

Only an increase counts: with the effects that the diagnosis found, the model leaves a larger residual both when an
effect begins and when it ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import t as student
from via_core.signals import Array

DAY = 86400.0  # [s] of motion with one false alarm at most on average
FEWEST = 12  # levels of the diagnosed motion
FARTHEST = 0.25  # of the number of levels: largest lag


@dataclass(frozen=True, eq=False)
class Expectation:
    """Levels of the motion that was diagnosed.

    correlation  (k,) at lags 1 .. k
    """

    mean: float
    sd: float
    count: int
    correlation: Array

    @classmethod
    def of(cls, levels: Array) -> Expectation | None:
        """From levels (n,) in order of time; None for fewer than FEWEST."""
        n = len(levels)
        if n < FEWEST:
            return None
        centred = levels - levels.mean()
        products = np.array([centred[: n - lag] @ centred[lag:] for lag in range(int(FARTHEST * n) + 1)])
        return cls(float(levels.mean()), float(levels.std(ddof=1)), n, products[1:] / max(products[0], 1e-300))

    def exceeded(self, levels: Array, period: float) -> bool:
        """Whether levels (m,) are higher than expected, at one false alarm per DAY of a test every `period` [s]."""
        if not len(levels):
            return False
        own, expected = self._correlated(len(levels)), self._correlated(self.count)
        scale = self.sd * sqrt(own / len(levels) + expected / self.count)
        freedom = max(self.count / expected - 1.0, 1.0)
        return bool(levels.mean() - self.mean > scale * student.isf(period / DAY, freedom))

    def _correlated(self, count: int) -> float:
        """C of so many levels."""
        lags = np.arange(1, min(count, len(self.correlation) + 1))
        return 1.0 + 2.0 * float(np.sum((1.0 - lags / count) * np.maximum(self.correlation[: len(lags)], 0.0)))
