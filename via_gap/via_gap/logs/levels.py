"""Noise levels of a measured channel: mean squares of the residuals of local polynomials, rounding treated exactly.

A local polynomial of degree p through p + 2 neighbouring samples leaves one residual, the divided difference with
weights of unit length, w. Its mean square is the noise variance plus a part of the motion, which decreases with the
degree if motion is slower than sampling. The chosen degree is the lowest one whose level agrees with all higher ones
within their standard errors (Lepski's method). The same with every second or fourth sample shows correlated noise.

Rounding is not white while the angle stays on a step. With Gaussian noise of standard deviation sigma before an encoder
of step s, two measurements that lie d steps apart have the rounding covariance

    s^2 / 12 rho(d),   rho(d) = 6 / pi^2 sum_k cos(2 pi k d) exp(-4 pi^2 k^2 sigma^2 / s^2) / k^2

averaged over the position within a step (the Fourier series of the sawtooth, each term damped by the characteristic
function of both noises), and each single one s^2 / 12. Sigma solves

    <(w y)^2> = sigma^2 + s^2 / 12 (1 + sum_{a != b} w_a w_b rho(d_ab)) + jitter^2 speed^2

where the last term shows as residuals that grow with speed.

Sources: Gasser, Sroka, Jennen-Steinmetz, Residual variance and residual pattern in nonlinear regression (Biometrika
1986): divided differences; Lepski, On a problem of adaptive estimation in Gaussian white noise (1990): the choice of
degree; Widrow, Kollar, Quantization Noise (2008), chapters 5 and 6: rounding with noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from math import comb, pi, sqrt
from typing import Any

import numpy as np
from scipy.linalg import toeplitz
from scipy.optimize import nnls
from via_core.signals import Array, Indices, Mask

DEGREES = (1, 2, 3, 4, 5, 6, 8)  # of local polynomials: higher ones need too long windows
STRIDES = (1, 2, 4)  # samples from one to the next in a window: correlation within four samples is filtering
COARSER = (8, 16, 32)  # used if the motion is too slow to cross an encoder step otherwise
BLOCK = 64  # windows over which squares are averaged
BLOCKS = 64  # used: the standard error of the standard deviation is then about 1.5 %
FEWEST = 32  # windows: with fewer, the standard deviation is uncertain by more than a quarter
CROSSING = 512  # least number of windows that cross a step: eight blocks
STANDARD_ERRORS = 3.0  # difference of two levels that is significant: probability 1 in 370 if they agree
SIGMAS = np.array([0.0, 0.02, 0.04, 0.07, 0.1, 0.14, 0.19, 0.25, 0.32, 0.4])  # steps: at .4, rho is below .002
POSITIONS = 256  # within a step, at which rho is tabulated
TERMS = 60  # of the Fourier series: at .02 steps of noise, the next one is damped to .003
OUTLIER = 3.0  # standard deviations: normal values beyond are .3 %, and change the mean by .1 % of one
EVERY = 4  # windows from one to the next for which rounding is predicted: it changes with speed only


@dataclass(frozen=True)
class Level:
    """Noise by windows of one stride and degree: variances before rounding and [s^2], standard error of the first."""

    stride: int
    degree: int
    variance: float
    jitter: float
    total: float  # variance, rounding and jitter as in the windows
    rounded: float  # the same of noise-free rounding
    total_error: float  # standard error of the total
    error: float  # standard error of the variance
    samples: int


def levels(time: Array, x: Array, step: float, crossed: float) -> list[Level]:
    """Noise levels, shortest stride first, from windows in which values cross `crossed` steps; empty: too few windows.

    time, x  (N,) [s], increasing, and measured values; step 0: not rounded
    """
    found: list[Level] = []
    for stride in (*STRIDES, *COARSER):
        if stride in COARSER and (found or step == 0.0):
            break
        tried = [level for p in DEGREES if (level := _level(time, x, step, crossed, stride, p)) is not None]
        if tried:
            found.append(_lowest_agreeing(tried))
    return found


def _lowest_agreeing(tried: list[Level]) -> Level:
    """The level of the lowest degree that agrees with all higher ones, with the least jitter of these."""

    def agree(low: Level, high: Level) -> bool:
        difference = (low.total - low.rounded) - (high.total - high.rounded)
        return bool(difference <= STANDARD_ERRORS * max(np.hypot(low.total_error, high.total_error), 1e-300))

    for i, level in enumerate(tried):
        if all(agree(level, other) for other in tried[i + 1 :]):
            return replace(level, jitter=min(each.jitter for each in tried[i:]))
    return tried[-1]


def _level(time: Array, x: Array, step: float, crossed: float, stride: int, degree: int) -> Level | None:
    """The level at one stride and degree; None if there are too few windows."""
    points = degree + 2
    reach = (points - 1) * stride
    count = len(x) - reach
    if count < FEWEST:
        return None
    wide = 2 * min(max(2 * reach, 8), (len(x) - 1) // 2) + 1  # samples of straight lines, whose slope is the speed
    moved, took = (_slopes(each, wide) for each in (x - x[0], time - time[0]))
    speed = (moved / took)[reach // 2 : reach // 2 + count]
    span = time[reach:] - time[:count]
    usable = span < 1.5 * float(np.median(span))
    if step > 0.0 and crossed > 0.0:
        usable &= np.abs(speed) * span >= crossed * step
        if usable.sum() < CROSSING:
            return None
    starts, size = _blocks(usable)
    if not starts.size:
        return None
    at = starts[:, None] + np.arange(0, reach + 1, stride)
    weights = _weights(time[at])
    residual = np.sum(weights * x[at], axis=1)
    squares = (residual**2).reshape(-1, size).mean(axis=1)
    quick = (speed[starts] ** 2).reshape(-1, size).mean(axis=1)
    uniform = _differences(degree)
    freedom = size / float(np.sum(np.correlate(uniform, uniform, "full") ** 2))
    relative = sqrt(2.0 / freedom / len(squares))  # standard error of the mean of chi-squared variables
    rounding = np.zeros((len(squares), 1))
    if step > 0.0:
        few = slice(None, None, EVERY)
        rounding = step**2 / 12.0 * _rounding(time[at[few]], speed[starts[few]] / step, weights[few], size // EVERY)
    total = _middle(squares)
    variance = _solve(squares, rounding, step)
    jitter = _jitter(squares - _at(rounding, variance, step), quick, relative, total)
    if jitter > 0.0:
        squares = squares - jitter * quick
        variance = _solve(squares, rounding, step)
    error = _solve(squares + relative * total, rounding, step) - variance
    alone = float(np.mean(rounding[:, 0]))
    return Level(stride, degree, variance, jitter, total, alone, relative * total, error, len(starts))


def _slopes(values: Array, wide: int) -> Array:
    """Slope (N,) per sample of the straight line through `wide` values around each; near an end, of the last ones."""
    half = wide // 2
    weights = np.arange(half, -half - 1, -1.0)
    return np.pad(np.convolve(values, weights / (weights @ weights), "valid"), half, mode="edge")


def _blocks(usable: Mask) -> tuple[Indices, int]:
    """First samples (blocks * size,) of windows in blocks at even distances, and the size of a block."""
    which = np.flatnonzero(usable)
    if len(which) < FEWEST:
        return which[:0], 0
    size = int(np.clip(len(which) // 16, 8, BLOCK)) // EVERY * EVERY
    count = len(which) // size
    chosen = np.unique(np.linspace(0, count - 1, min(count, BLOCKS)).round().astype(int))
    return which[(chosen[:, None] * size + np.arange(size)).ravel()], size


def _weights(time: Array) -> Array:
    """(n, points) unit vectors that are orthogonal to all polynomials of degree points - 2 in time (n, points)."""
    apart = time[:, :, None] - time[:, None, :]
    scale = (time[:, -1:] - time[:, :1]) / (time.shape[1] - 1)
    apart = apart / scale[:, :, None] + np.eye(time.shape[1])
    weights = 1.0 / np.prod(apart, axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _rounding(time: Array, speed: Array, weights: Array, size: int) -> Array:
    """Mean squares of residuals (blocks, SIGMAS) by rounding alone, over 1/12 of a step squared; speed [steps/s]."""
    total = np.ones((len(time), len(SIGMAS)))
    for a, b in combinations(range(time.shape[1]), 2):
        apart = speed * (time[:, b] - time[:, a])
        place = np.minimum((apart - np.floor(apart)) * POSITIONS, POSITIONS - 1).astype(np.intp)
        total += (2.0 * weights[:, a] * weights[:, b])[:, None] * _covariance()[place]
    return total.reshape(-1, size, len(SIGMAS)).mean(axis=1)


@cache
def _covariance() -> Array:
    """rho (POSITIONS, SIGMAS) at the middle of every interval of a step."""
    d = (np.arange(POSITIONS) + 0.5) / POSITIONS
    k = np.arange(1, TERMS + 1)
    damped = np.exp(-4.0 * pi**2 * np.outer(k**2, SIGMAS[1:] ** 2)) / k[:, None] ** 2
    sharp = 1.0 - 6.0 * d * (1.0 - d)
    return np.column_stack([sharp, 6.0 / pi**2 * np.cos(2.0 * pi * np.outer(d, k)) @ damped])


def _at(rounding: Array, variance: float, step: float) -> Array:
    """Rounding (blocks,) of (blocks, SIGMAS) with noise of a variance before it."""
    if step == 0.0:
        return rounding[:, 0]
    sigma = min(sqrt(variance) / step, SIGMAS[-1])
    after = int(np.clip(np.searchsorted(SIGMAS, sigma), 1, len(SIGMAS) - 1))
    share = (sigma - SIGMAS[after - 1]) / (SIGMAS[after] - SIGMAS[after - 1])
    return (1.0 - share) * rounding[:, after - 1] + share * rounding[:, after]


def _middle(values: Array) -> Any:
    """Mean over blocks (blocks, ...), in which outliers are limited to OUTLIER standard deviations from the median.

    The median would be biased: rounding errors of blocks in which the angle moves half a step per sample are skewed.
    """
    median = np.median(values, axis=0)
    reach = OUTLIER * (1.4826 * np.median(np.abs(values - median), axis=0))
    return np.mean(np.clip(values, median - reach, median + reach), axis=0)


def _solve(squares: Array, rounding: Array, step: float) -> float:
    """Variance before rounding, from the mean of blocks; 0 if rounding alone explains it."""
    if step == 0.0:
        return max(_middle(squares), 0.0)
    left = _middle(squares[:, None] - rounding) - (SIGMAS * step) ** 2
    if left[0] <= 0.0:
        return 0.0
    if left[-1] >= 0.0:
        return float(left[-1] + (SIGMAS[-1] * step) ** 2)
    after = int(np.argmax(left < 0.0))
    share = left[after - 1] / (left[after - 1] - left[after])
    return float((step * ((1.0 - share) * SIGMAS[after - 1] + share * SIGMAS[after])) ** 2)


def _jitter(squares: Array, quick: Array, relative: float, scale: float) -> float:
    """Variance [s^2] of time stamps: slope of block means (blocks,) over squared speed (blocks,).

    0 unless it is beyond STANDARD_ERRORS of its standard error.
    """
    groups = np.array_split(np.argsort(quick), min(8, len(squares) // 4))
    if len(groups) < 3 or quick.max() <= 0.0:
        return 0.0
    y = np.array([np.median(squares[g]) for g in groups])
    v = np.array([np.mean(quick[g]) for g in groups]) / quick.max()
    sd = relative * sqrt(len(groups)) * (np.abs(y) + 0.1 * scale)  # slow ones show the noise
    sd += 1e-150  # whose inverse square is finite
    design = np.column_stack([np.ones(len(v)), v]) / sd[:, None]
    size = np.linalg.norm(design)
    answer, _ = nnls(design / size, y / sd / size)
    slope_sd = sqrt(float(np.linalg.pinv(design.T @ design)[1, 1]))
    return float(answer[1] / quick.max()) if answer[1] > STANDARD_ERRORS * slope_sd else 0.0


def _differences(degree: int) -> Array:
    """Unit weights of a difference of evenly spaced samples that vanishes for polynomials of a degree."""
    weights = np.array([(-1) ** j * comb(degree + 1, j) for j in range(degree + 2)], dtype=np.float64)
    return weights / np.linalg.norm(weights)


def share_shown(ar1: float, degree: int) -> float:
    """Share of the variance of first-order noise in residuals of one degree, whose weights are a high-pass filter."""
    weights = _differences(degree)
    return float(weights @ toeplitz(ar1 ** np.arange(degree + 2)) @ weights)
