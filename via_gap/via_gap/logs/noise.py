"""Measurement noise of every channel, estimated from the log itself (`via_gap.logs.levels` derives how).

The device file cannot state the noise before an encoder's rounding, nor that of a filter or of time stamps. The
estimate, not the declared value, is the floor of every comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import Literal

import numpy as np
from via_core.encoder_steps import step_of
from via_core.signals import Array

from via_gap.logs.levels import STANDARD_ERRORS, Level, levels, share_shown
from via_gap.logs.log import JointLog
from via_gap.logs.rounding import correlation, distances, mean_variance

How = Literal["residuals", "rounding only", "smoothed", "standstill", "too short", "stated"]
STEPPED = 1.0  # encoder steps crossed within a window: all positions within a step are then met
QUICKEST = 100.0  # [Hz] at least of strided samples: four in a period of the quickest motion looked for, 25 Hz
HARMONICS = 12  # of the sawtooth: at .05 steps of noise the next is damped to 6e-8, without noise to .6 % of the first
LATEST = 8  # samples by which a torque may follow its command; later, the estimate without the command stays
LONGEST = 0.9  # correlation from sample to sample: of a longer one, a stride of four shows too little


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one measured channel, in its unit."""

    sd: float  # standard deviation of one measurement, rounding included: the floor of any comparison
    white: float  # the same before rounding; 0 where rounding explains everything
    quantum: float  # step of the grid on which the values lie, or the declared one; 0: no step
    ar1: float  # correlation of the noise before rounding from one sample to the next
    jitter: float  # [s] error of the time stamps, as residuals that grow with speed show it
    error: float  # standard error of `sd`, relative
    samples: int  # residuals used
    how: How  # where `sd` comes from; 'smoothed': values smoother than their step allows, `sd` is the step's


@dataclass(frozen=True)
class Clock:
    """Sampling of a log."""

    period: float  # [s] from sample to sample, the median
    jitter: float  # [s] standard deviation of stamps about the nearest smooth clock


@dataclass(frozen=True)
class LogNoise:
    """Noise of all measured channels of a log: q, theta_1, theta_2, tau_1, tau_2."""

    channels: Mapping[str, ChannelNoise]
    declared: Mapping[str, float | None]  # by the device file: step / sqrt(12), or the torque noise; None: not stated
    clock: Clock

    @property
    def jitter(self) -> float:
        """[s] error of the time stamps that the link shows, whose inertia keeps its motion smooth."""
        return self.channels["q"].jitter

    def floor(self, name: str, speed: Array) -> Array:
        """Standard deviation (...) of measurements of a channel at speeds (...) [unit of the channel per second]."""
        noise = self.channels[name]
        return np.sqrt(noise.sd**2 + (noise.jitter * np.asarray(speed)) ** 2)


def log_noise(log: JointLog) -> LogNoise:
    """Noise of every measured channel of a log, beside what the device file declares."""
    channels: dict[str, ChannelNoise] = {}
    declared: dict[str, float | None] = {}
    for name, column, quantum in log.angles:
        channels[name] = channel_noise(log.measured.time, column, quantum)
        declared[name] = None if quantum is None else quantum / sqrt(12.0)
    if log.torque is not None:
        for i, column in enumerate(log.torque.T):
            if np.isfinite(column).sum() >= 2:
                channels[f"tau_{i + 1}"] = _torque_noise(log, i, column)
                declared[f"tau_{i + 1}"] = log.device.sensors.torque_noise or None
    return LogNoise(channels, declared, clock_of(log.measured.time))


def stated_noise(log: JointLog) -> LogNoise:
    """Noise of a simulated log, whose sensors are those of the device file: `log_noise` without an estimate."""
    period, torque = float(np.median(np.diff(log.measured.time))), log.device.sensors.torque_noise
    known = {name: (0.0, quantum or 0.0) for name, _, quantum in log.angles}
    known |= {f"tau_{i + 1}": (torque, 0.0) for i in range(0 if log.torque is None else log.torque.shape[1])}
    channels = {
        name: ChannelNoise(sqrt(white**2 + step**2 / 12.0), white, step, 0.0, 0.0, 0.0, len(log.measured), "stated")
        for name, (white, step) in known.items()
    }
    return LogNoise(channels, {name: each.sd for name, each in channels.items()}, Clock(period, 0.0))


def clock_of(time: Array) -> Clock:
    """Period and jitter of stamps (N,) [s]; lost samples and a slow drift of the clock do not count as jitter."""
    period = float(np.median(np.diff(time)))
    return Clock(period, channel_noise(sample_numbers(time) * period, time, 0.0).white)


def sample_numbers(time: Array) -> Array:
    """(N,) numbers of samples with stamps (N,) [s]; lost ones are counted."""
    steps = np.diff(time)
    return np.concatenate(([0.0], np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1.0))))


def stamp_jitter(time: Array) -> float:
    """[s] standard deviation of the stamps (N,) [s], N >= 3, of a periodic sender; 0 for others.

    A wrong stamp makes one interval longer and the next one shorter. So minus the covariance of neighbouring intervals
    is the variance of stamps. It is 0 for a sender without a period, within the standard errors of a covariance.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    late = steps - period * np.maximum(np.rint(steps / period), 1.0)
    late = late - np.mean(late)
    variance = -float(np.mean(late[1:] * late[:-1]))
    error = float(np.mean(late**2)) / sqrt(len(late) - 1)
    return sqrt(variance) if variance > STANDARD_ERRORS * error else 0.0


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
        return ChannelNoise(max(rounded, resolution), 0.0, step, 0.0, 0.0, 0.0, len(x), "too short")
    found = levels(t, x, step, STEPPED)
    still = not found
    if still:
        found = levels(t, x, step, 0.0)
    if not found:
        apart = float(np.sqrt(np.median(np.diff(x) ** 2) / 2.0) * 1.4826) if len(x) > 2 else 0.0
        sd = max(rounded if step > 0.0 else min(float(np.std(x)), apart), resolution)
        return ChannelNoise(sd, 0.0 if step > 0.0 else sd, step, 0.0, 0.0, 1.0, len(x), "too short")
    first, period = found[0], float(np.median(np.diff(t)))
    variance, ar1 = _correlated(found, 1.0 / period)
    significant = variance > STANDARD_ERRORS * first.error
    white = sqrt(variance) if significant or step == 0.0 else 0.0
    sd = sqrt(white**2 + rounded**2 + resolution**2)
    how: How = "standstill" if still and step > 0.0 else "residuals"
    if step > 0.0 and not significant:
        smooth = first.total + STANDARD_ERRORS * first.total_error < first.rounded and not still
        how = "smoothed" if smooth else "rounding only"
    relative = min(0.5 * first.error / sd**2, 1.0)
    return ChannelNoise(sd, white, step, ar1, sqrt(first.jitter), relative, first.samples, how)


def error_correlation(noise: ChannelNoise, angle: Array, lags: int, run: int = 0) -> Array:
    """(lags,) mean correlation of the errors of two measurements at each lag; `angle` (T,) smoothed.

    As `via_gap.logs.rounding.correlation`, with noise before rounding, which whitens rounding errors.
    """
    rounded, white = noise.quantum**2 / 12.0, noise.white**2
    before = np.power(noise.ar1, np.arange(lags, dtype=np.float64))
    if rounded == 0.0:
        return before
    sharp = correlation(angle, noise.quantum, lags, run)
    if white == 0.0:
        return sharp
    apart = distances(angle, noise.quantum, lags, run)
    harmonics = np.arange(1, HARMONICS + 1)
    damped = np.exp(-4.0 * pi**2 * harmonics**2 * white / noise.quantum**2) / harmonics**2
    cosines = [np.cos(2.0 * pi * k * apart).mean(axis=0) if len(apart) else np.zeros(lags) for k in harmonics]
    after = 6.0 / pi**2 * damped @ np.array(cosines)
    after[0] = 1.0  # one measurement with itself shares its noise
    return (white * before + rounded * after) / (white + rounded)


def torque_densities(log: JointLog, known: LogNoise, span: float) -> Array:
    """(m,) spectral density [N^2 m^2 s] of the noise of each measured torque: of its mean over `span` [s], times span.

    Noise counts as white: the density is that at the frequencies to which a joint responds.
    """
    period = known.clock.period
    found = []
    assert log.torque is not None, "only for logs with torques"
    for i, column in enumerate(log.torque.T):
        seen = column[np.isfinite(column)]
        count = max(1, min(round(span / period), len(seen)))
        noise = known.channels[f"tau_{i + 1}"]
        found.append(noise.sd**2 * mean_variance(error_correlation(noise, seen, count)) * count * period)
    return np.array(found)


def _torque_noise(log: JointLog, i: int, column: Array) -> ChannelNoise:
    """Noise of a measured torque, with a known command that of the difference from it, if it is less.

    Without the command the estimate is an upper bound, because the torque contains the noise of the controller.
    """
    alone = channel_noise(log.measured.time, column)
    if log.commands is None or len(log.commands) < 2 or log.motor_commands(0) is None:
        return alone
    left = [column - commands[:, i] for late in range(LATEST) if (commands := log.motor_commands(late)) is not None]
    beside = channel_noise(log.measured.time, min(left, key=lambda each: float(np.nanvar(each))), alone.quantum)
    return beside if beside.sd < alone.sd else alone


def _correlated(found: list[Level], rate: float) -> tuple[float, float]:
    """Variance before rounding, and its correlation from sample to sample, from levels at increasing strides.

    If three strides are consistent with the noise of a first-order filter, its correlation is estimated; otherwise the
    noise counts as white.
    """
    first, three = found[0], [each for each in found[:3] if rate / each.stride >= QUICKEST]
    white = (first.variance, 0.0)
    if len(three) < 3 or any(each.variance <= STANDARD_ERRORS * each.error for each in three):
        return white
    seen = np.array([each.variance for each in three])
    relative = np.maximum(np.array([each.error for each in three]) / seen, 1e-6)  # jumps alone leave no error
    if np.any(np.diff(seen) <= 0.0) or seen[2] - seen[0] < STANDARD_ERRORS * np.hypot(three[0].error, three[2].error):
        return white
    tried = []
    for a in np.linspace(0.0, LONGEST, 46):
        ratio = np.log(seen / [share_shown(a ** (each.stride / first.stride), each.degree) for each in three])
        mean = float(np.average(ratio, weights=relative**-2.0))
        misfit = float(np.sum(((ratio - mean) / relative) ** 2))
        tried.append((misfit, exp(mean), float(a)))
    best = min(tried)[0]
    if best > STANDARD_ERRORS**2:
        return white
    return next((variance, a) for misfit, variance, a in tried if misfit <= best + 1.0)  # least within an error
