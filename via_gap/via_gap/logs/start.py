"""Angle and velocity of one channel at the first sample of a log, which may begin in the middle of a motion.

Polynomials of degree 0 to 3 are fitted to the first 5 to 65 samples. Those with a residual larger than noise explains
are dropped. Of the others the one with the least variance of the velocity is used, if its velocity agrees with that of
every fit of larger variance: a joint at rest gives a constant, which has the velocity zero, and the quicker the motion,
the shorter the window or the higher the degree. If none is left, it is the cubic through the first five. A spike among
the first samples is left out. A motion of less than a step of the encoder within some tens of samples counts as rest.

Source: intersection of confidence intervals: Goldenshluger, Nemirovski, On spatially adaptive estimation of
nonparametric regression, Math. Methods Statist. 6 (1997).
"""

from __future__ import annotations

from math import nan, sqrt
from typing import NamedTuple

import numpy as np
from via_core.signals import Array

from via_gap.logs.noise import channel_noise

WINDOWS = (5, 9, 17, 33, 65)  # samples
FIRST = 9  # samples among which one must be finite, and one may be a spike
SPIKE = 10.0  # standard deviations: of noise, and of the other residuals of a parabola
HIGHEST = 3  # degree
NEAR = 2000  # samples whose noise is taken
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal number
STANDARD_ERRORS = 3.0  # of a sum of squares, and of the difference of two velocities


class _Fit(NamedTuple):
    angle: float
    velocity: float
    sd: float  # of the velocity
    explained: bool  # whether noise explains its residual


def motion_at_start(time: Array, values: Array) -> tuple[float, float]:
    """Angle and velocity of `values` (N,) at the first of `time` (N,) [s]; NaN without a finite one among FIRST."""
    there = np.isfinite(values)
    if not np.any(there[:FIRST]):
        return nan, nan
    t, x = time[there] - time[0], values[there]
    noise = channel_noise(t[:NEAR], x[:NEAR]).sd
    t, x = _without_spike(t, x, noise)
    if len(x) < WINDOWS[0]:
        return float(np.median(x)), 0.0
    noise = max(noise, _unevenness(x[: WINDOWS[-1]]))
    tried = [
        _fit(t[:count], x[:count], degree, noise)
        for count in WINDOWS
        for degree in range(min(HIGHEST, count - 2) + 1)
        if count <= len(x)
    ]
    best = _fit(t[: WINDOWS[0]], x[: WINDOWS[0]], HIGHEST, noise)
    fits = sorted((fit for fit in tried if fit.explained), key=lambda fit: -fit.sd)
    for k, fit in enumerate(fits):
        if all(abs(fit.velocity - other.velocity) <= STANDARD_ERRORS * other.sd for other in fits[:k]):
            best = fit
    return best.angle, best.velocity


def _without_spike(t: Array, x: Array, noise: float) -> tuple[Array, Array]:
    """The samples without one among the first that is far from the parabola through the others there."""
    if len(x) < FIRST:
        return t, x
    basis = np.linalg.qr(np.vander(t[:FIRST], 3))[0]
    left = x[:FIRST] - basis @ (basis.T @ x[:FIRST])
    share = left**2 / (1.0 - np.sum(basis**2, axis=1))  # of the sum of squares, due to each sample
    rest = np.maximum((np.sum(left**2) - share) / (FIRST - 4), noise**2)
    worst = int(np.argmax(share - SPIKE**2 * rest))
    if share[worst] <= SPIKE**2 * rest[worst]:
        return t, x
    return np.delete(t, worst), np.delete(x, worst)


def _unevenness(x: Array) -> float:
    """Standard deviation of what a cubic through five neighbours leaves: noise, or bends of a motion without noise."""
    left = np.diff(x, 4) / sqrt(70.0)  # 70: the sum of squares of its weights 1, -4, 6, -4, 1
    return float(np.median(np.abs(left))) / NORMAL_MEDIAN if len(left) else 0.0


def _fit(t: Array, x: Array, degree: int, noise: float) -> _Fit:
    """A polynomial through all samples."""
    design = np.vander(t / t[-1], degree + 1, increasing=True)
    found = np.linalg.lstsq(design, x, rcond=None)[0]
    free = len(x) - degree - 1
    square = float(np.sum((x - design @ found) ** 2))
    explained = square <= noise**2 * (free + STANDARD_ERRORS * sqrt(2.0 * free))
    if degree == 0:
        return _Fit(float(found[0]), 0.0, 0.0, explained)
    inverse = np.linalg.inv(design.T @ design)
    return _Fit(float(found[0]), float(found[1] / t[-1]), noise * sqrt(inverse[1, 1]) / t[-1], explained)
