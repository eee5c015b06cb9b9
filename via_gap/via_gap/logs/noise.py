"""Measurement noise of every channel, estimated from the log itself.

A local polynomial of degree p through p + 2 neighbouring samples leaves one residual, the divided difference with
weights of unit length, w. Its mean square is the noise variance plus what motion leaves, which falls with every degree
as long as motion is slower than sampling. The degree is the lowest one whose level agrees with all higher ones within
their standard errors (Lepski's method). The same with every second or fourth sample shows correlated noise.

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

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from math import comb, exp, pi, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.optimize import nnls
from scipy.signal import savgol_filter
from via_core.signals import Array

from via_gap.data_check import step_of
from via_gap.log import JointLog
from via_gap.rounding import correlation

How = Literal["residuals", "rounding only", "smoothed", "standstill", "too short"]
DEGREES = (1, 2, 3, 4, 5, 6, 8)  # of local polynomials: more need windows over which rounding errors stay in step
STRIDES = (1, 2, 4)  # samples from one to the next in a window: correlation within four samples is filtering
COARSER = (8, 16, 32)  # taken where the motion is too slow to cross an encoder step otherwise
BLOCK = 64  # windows over which squares are averaged
BLOCKS = 128  # looked at: the standard error of the standard deviation is then about 1 %
FEWEST = 32  # windows: with fewer, the standard deviation is uncertain by more than a quarter
CROSSING = 512  # windows that cross a step: eight blocks, so that one or two do not decide
STANDARD_ERRORS = 3.0  # one chance in 370 that two levels that agree are taken to differ
STEPPED = 1.0  # encoder steps crossed within a window: all positions within a step are then met
SIGMAS = np.array([0.0, 0.02, 0.04, 0.07, 0.1, 0.14, 0.19, 0.25, 0.32, 0.4])  # steps: at .4, rho is below .002
POSITIONS = 256  # within a step, at which rho is tabulated
TERMS = 60  # of the Fourier series: at .02 steps of noise, the next one is damped to .003
OUTLIER = 3.0  # standard deviations: normal values beyond are .3 %, and change the mean by .1 % of one
QUICKEST = 100.0  # [Hz] at least of strided samples: four in a period of the quickest motion looked for, 25 Hz
LONGEST = 0.9  # correlation from sample to sample: of a longer one, a stride of four shows too little
EVERY = 4  # windows from one to the next for which rounding is predicted: it changes with speed only


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one measured channel, in its unit.

    sd                one measurement's standard deviation, rounding included: the floor of any comparison
    white             the same before rounding; 0 where rounding explains everything
    quantum           step of the grid on which the values lie, or the declared one; 0: no step
    ar1               correlation of the noise before rounding from one sample to the next
    correlation_time  [s] over which it falls to 1/e; 0: white
    jitter            [s] error of the time stamps, as residuals that grow with speed show it
    error             standard error of `sd`, relative
    samples           residuals used
    how               where `sd` comes from; 'smoothed': values smoother than their step allows, `sd` is the step's
    """

    sd: float
    white: float
    quantum: float
    ar1: float
    correlation_time: float
    jitter: float
    error: float
    samples: int
    how: How


@dataclass(frozen=True)
class Clock:
    """Sampling of a log.

    period      [s] from sample to sample, the median
    jitter      [s] standard deviation of stamps about the nearest smooth clock
    """

    period: float
    jitter: float


@dataclass(frozen=True)
class LogNoise:
    """Noise of all measured channels of a log: q, theta_1, theta_2, tau_1, tau_2.

    channels  name -> estimate
    declared  name -> standard deviation by the device file: step / sqrt(12), or the torque noise; None: not stated
    clock     of the time stamps
    """

    channels: Mapping[str, ChannelNoise]
    declared: Mapping[str, float | None]
    clock: Clock

    @property
    def jitter(self) -> float:
        """[s] error of the time stamps that the angles show: the largest of those found in them."""
        return max((each.jitter for name, each in self.channels.items() if not name.startswith("tau")), default=0.0)

    def floor(self, name: str, speed: Array) -> Array:
        """Standard deviation (...) of measurements of a channel at speeds (...) [unit of the channel per second]."""
        noise = self.channels[name]
        return np.sqrt(noise.sd**2 + (noise.jitter * np.asarray(speed)) ** 2)


@dataclass(frozen=True)
class _Level:
    """Noise by windows of one stride and degree: variances before rounding and [s^2], standard error of the first."""

    stride: int
    degree: int
    variance: float
    jitter: float
    total: float  # variance, rounding and jitter as in the windows
    rounded: float  # the same of noise-free rounding
    spread: float  # standard error of the total
    error: float  # of the variance
    samples: int


def log_noise(log: JointLog) -> LogNoise:
    """Noise of every measured channel of a log, beside what the device file declares."""
    sensors, time = log.device.sensors, log.measured.time
    channels: dict[str, ChannelNoise] = {}
    declared: dict[str, float | None] = {}
    for name, column, quantum in _angles(log):
        channels[name] = channel_noise(time, column, quantum)
        declared[name] = None if quantum is None else quantum / sqrt(12.0)
    if "tau" in log.measured:
        for i, column in enumerate(log.measured["tau"].T):
            if np.isfinite(column).sum() >= 2:
                channels[f"tau_{i + 1}"] = _torque_noise(log, i, column)
                declared[f"tau_{i + 1}"] = sensors.torque_noise or None
    return LogNoise(channels, declared, clock_of(time))


def clock_of(time: Array) -> Clock:
    """Period and jitter of stamps (N,) [s]. Lost samples are counted as such, a clock that drifts is followed."""
    period = float(np.median(np.diff(time)))
    count = np.concatenate(([0.0], np.cumsum(np.maximum(np.rint(np.diff(time) / period), 1.0))))
    return Clock(period, channel_noise(count * period, time, 0.0).white)


def channel_noise(time: Array, values: Array, quantum: float | None = None) -> ChannelNoise:
    """Noise of `values` (N,) measured at `time` (N,) [s], increasing; NaN marks lost measurements.

    quantum  step that the device file declares, 0 for none; a coarser grid on which the values lie replaces it
    """
    there = np.isfinite(values)
    t, x = np.asarray(time)[there], np.asarray(values)[there]
    visible = step_of(x) if len(x) > 1 and quantum != 0.0 else 0.0
    step = max(quantum or 0.0, visible)
    rounded = step / sqrt(12.0)
    resolution = float(np.spacing(np.max(np.abs(x)))) if x.size else 0.0
    if len(x) < 2 or np.ptp(x) == 0.0:
        return ChannelNoise(max(rounded, resolution), 0.0, step, 0.0, 0.0, 0.0, 0.0, len(x), "too short")
    levels = _levels(t, x, step, STEPPED)
    still = not levels
    if still:
        levels = _levels(t, x, step, 0.0)
    if not levels:
        sd = max(rounded, resolution) if step > 0.0 else max(min(float(np.std(x)), _difference(x)), resolution)
        return ChannelNoise(sd, 0.0 if step > 0.0 else sd, step, 0.0, 0.0, 0.0, 1.0, len(x), "too short")
    first, period = levels[0], float(np.median(np.diff(t)))
    variance, ar1 = _correlated(levels, 1.0 / period)
    significant = variance > STANDARD_ERRORS * first.error
    white = sqrt(variance) if significant or step == 0.0 else 0.0
    sd = sqrt(white**2 + rounded**2 + resolution**2)
    how: How = "standstill" if still and step > 0.0 else "residuals"
    if step > 0.0 and not significant:
        smooth = first.total + STANDARD_ERRORS * first.spread < first.rounded and not still
        how = "smoothed" if smooth else "rounding only"
    lag = -period * first.stride / np.log(ar1) if ar1 > 0.0 and white > 0.0 else 0.0
    relative = min(0.5 * first.error / sd**2, 1.0)
    return ChannelNoise(sd, white, step, ar1, float(lag), sqrt(first.jitter), relative, first.samples, how)


def error_correlation(noise: ChannelNoise, angle: Array, lags: int, run: int = 0) -> Array:
    """(lags,) mean correlation of the errors of measurements so many samples apart; `angle` (T,) as smooth as known.

    As `via_gap.rounding.correlation`, of rounding with noise: noise before it whitens rounding errors.
    """
    rounded, white = noise.quantum**2 / 12.0, noise.white**2
    sharp = correlation(angle, noise.quantum, lags, run) if noise.quantum > 0.0 else np.eye(1, lags)[0]
    before = noise.ar1 ** np.arange(lags)
    dither = exp(-4.0 * pi**2 * white / noise.quantum**2) if noise.quantum > 0.0 else 0.0
    after = sharp * np.where(np.arange(lags) == 0, 1.0, dither)
    return (white * before + rounded * after) / (white + rounded) if white + rounded > 0.0 else sharp


def _angles(log: JointLog) -> list[tuple[str, Array, float | None]]:
    sensors = log.device.sensors
    found: list[tuple[str, Array, float | None]] = [("q", log.measured["q"], sensors.link_quantum)]
    for i, column in enumerate(log.measured["theta"].T if "theta" in log.measured else ()):
        if np.isfinite(column).sum() >= 2:
            found.append((f"theta_{i + 1}", column, sensors.motor_quantum))
    return found


def _torque_noise(log: JointLog, i: int, column: Array) -> ChannelNoise:
    """That of a torque: where its command is known, of what the command does not account for, if that is less.

    A controller's own noise is in the torque, too: without the command the estimate is an upper bound.
    """
    time = log.measured.time
    alone = channel_noise(time, column)
    if log.commands is None or "motor" not in log.commands or len(log.commands) < 2:
        return alone
    command, period = log.commands["motor"][:, i], float(np.median(np.diff(time)))
    best = alone
    for late in range(8):  # samples: longer delays of a drive leave the estimate that needs no command
        at = np.clip(np.searchsorted(log.commands.time, time - (late + 0.5) * period, side="right") - 1, 0, None)
        left = channel_noise(time, column - command[at], alone.quantum or None)
        best = left if left.sd < best.sd else best
    return best


def _difference(x: Array) -> float:
    return float(np.sqrt(np.median(np.diff(x) ** 2) / 2.0) * 1.4826) if len(x) > 2 else 0.0


def _levels(time: Array, x: Array, step: float, crossed: float) -> list[_Level]:
    """Converged noise levels, shortest stride first; of windows over which the angle crosses so many steps."""
    found: list[_Level] = []
    for stride in (*STRIDES, *COARSER):
        if stride in COARSER and (found or step == 0.0):
            break
        tried = [level for p in DEGREES if (level := _level(time, x, step, crossed, stride, p)) is not None]
        if tried:
            found.append(_lowest_agreeing(tried))
    return found


def _lowest_agreeing(levels: list[_Level]) -> _Level:
    """The level of the lowest degree with which all higher ones agree, and the least jitter that these see."""
    for i, level in enumerate(levels):
        above = levels[i + 1 :]
        if all(_apart(level, other) <= STANDARD_ERRORS for other in above):
            return replace(level, jitter=min(each.jitter for each in levels[i:]))
    return levels[-1]


def _apart(low: _Level, high: _Level) -> float:
    """By how many standard errors the lower degree leaves more than the higher one, rounding aside."""
    difference = (low.total - low.rounded) - (high.total - high.rounded)
    return float(difference / max(np.hypot(low.spread, high.spread), 1e-300))


def _level(time: Array, x: Array, step: float, crossed: float, stride: int, degree: int) -> _Level | None:
    """The level at one stride and degree; None where too few windows are left."""
    points = degree + 2
    reach = (points - 1) * stride
    count = len(x) - reach
    if count < FEWEST:
        return None
    half = min(max(2 * reach, 8), (len(x) - 1) // 2)
    speed = _speed(time, x, max(half, 1))[reach // 2 : reach // 2 + count]
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
    return _Level(stride, degree, variance, jitter, total, alone, relative * total, error, len(starts))


def _blocks(usable: NDArray[np.bool_]) -> tuple[Array, int]:
    """First samples of windows in blocks of neighbours (blocks * size,), spread evenly, and the size of a block."""
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


def _speed(time: Array, x: Array, half: int) -> Array:
    """Slope (N,) of straight lines over `half` samples to either side."""
    window = min(2 * half + 1, (len(x) - 1) // 2 * 2 + 1)
    moved, took = (savgol_filter(each, window, 1, deriv=1) for each in (x - x[0], time - time[0]))
    return moved / took


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
    """Mean over blocks (blocks, ...) of which outliers count as OUTLIER deviations from the median.

    Rounding errors of blocks in which the angle moves half a step per sample are skewed: their median is not their
    mean.
    """
    median = np.median(values, axis=0)
    deviation = 1.4826 * np.median(np.abs(values - median), axis=0)
    return np.mean(np.clip(values, median - OUTLIER * deviation, median + OUTLIER * deviation), axis=0)


def _solve(squares: Array, rounding: Array, step: float) -> float:
    """Variance before rounding that blocks show in the mean; 0 where rounding alone makes as much."""
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
    """Variance [s^2] of time stamps, by which block means (blocks,) grow with squared speed (blocks,).

    0 unless it is beyond STANDARD_ERRORS of its standard error.
    """
    groups = np.array_split(np.argsort(quick), min(8, len(squares) // 4))
    if len(groups) < 3 or quick.max() <= 0.0:
        return 0.0
    y = np.array([np.median(squares[g]) for g in groups])
    v = np.array([np.mean(quick[g]) for g in groups]) / quick.max()
    sd = relative * sqrt(len(groups)) * (np.abs(y) + scale) + 1e-300
    design = np.column_stack([np.ones(len(v)), v]) / sd[:, None]
    size = np.linalg.norm(design)
    answer, _ = nnls(design / size, y / sd / size)
    slope_sd = sqrt(float(np.linalg.pinv(design.T @ design)[1, 1]))
    return float(answer[1] / quick.max()) if answer[1] > STANDARD_ERRORS * slope_sd else 0.0


def _correlated(levels: list[_Level], rate: float) -> tuple[float, float]:
    """Variance before rounding, and its correlation from sample to sample, of the levels at growing strides.

    Noise of a first-order filter grows from stride to stride by one number; motion that is too quick for a stride grows
    otherwise. Without three strides that agree on that number, noise counts as white.
    """
    first, three = levels[0], [each for each in levels[:3] if rate / each.stride >= QUICKEST]
    white = (first.variance, 0.0)
    if len(three) < 3 or any(each.variance <= STANDARD_ERRORS * each.error for each in three):
        return white
    seen = np.array([each.variance for each in three])
    relative = np.array([each.error for each in three]) / seen
    if np.any(np.diff(seen) <= 0.0) or seen[2] - seen[0] < STANDARD_ERRORS * np.hypot(three[0].error, three[2].error):
        return white
    tried = []
    for a in np.linspace(0.0, LONGEST, 46):
        ratio = np.log(seen / [_share(a ** (each.stride / first.stride), each.degree) for each in three])
        mean = float(np.average(ratio, weights=relative**-2.0))
        misfit = float(np.sum(((ratio - mean) / relative) ** 2))
        tried.append((misfit, exp(mean), float(a)))
    best = min(tried)[0]
    if best > STANDARD_ERRORS**2:
        return white
    return next((variance, a) for misfit, variance, a in tried if misfit <= best + 1.0)  # least within an error


def _differences(degree: int) -> Array:
    """The unit weights of a difference of evenly spaced samples that leaves nothing of polynomials of a degree."""
    weights = np.array([(-1) ** j * comb(degree + 1, j) for j in range(degree + 2)], dtype=np.float64)
    return weights / np.linalg.norm(weights)


def _share(ar1: float, degree: int) -> float:
    """Of the variance of first-order noise, what residuals of one degree show: less, as their weights are high-pass."""
    weights = _differences(degree)
    return float(weights @ toeplitz(ar1 ** np.arange(degree + 2)) @ weights)
