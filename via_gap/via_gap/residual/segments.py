"""Short segments of a log, as in multiple shooting: start, commands and measurements of each.

The simulation of a torque-driven joint from the first sample drifts for any small error and is uninformative after a
second. If it restarts every quarter of a second, its error shows the errors of the model in that segment (rollout.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np
from scipy.signal import savgol_filter
from via_core.errors import SignalError
from via_core.signals import Array, Mask
from via_core.signals import Indices as Indices
from via_sim.plants import JointPlant

from via_gap.logs.between import in_lines
from via_gap.logs.log import JointLog, angle_of, quantum
from via_gap.logs.noise import LogNoise, error_correlation, log_noise, torque_densities
from via_gap.logs.quality import SEGMENT, SPANS, Quality
from via_gap.logs.rounding import interpolated, mean_variance, variances
from via_gap.logs.start import FIRST
from via_gap.residual.cuts import RESTING, begins, inside, rest_from
from via_gap.residual.driven import drive_rows, measured_columns
from via_gap.residual.smoothing import smoothed, window_of

# [Hz] ticks: a slower log is simulated with several ticks per sample, one for each command up to FASTEST, beyond the
# bandwidth of any joint
SLOWEST, FASTEST = 500.0, 2000.0
BIN = 0.004  # [s] over which angles are averaged before they are compared
START, START_SPEED = 2.0, 0.03  # times the sensor noise; [rad/s]: sd of a smoothed start, bias included
SLOW = 0.01  # of the root mean square speed of an axis: with less it nearly rests
SMOOTHING = 0.012  # [s] to either side of a start over which angle and velocity are fitted
ROUNDED = 1e-6  # of a tick
SMALLEST = 1e-6  # [rad] of a noise
LOST = 1.5  # periods between two samples from which one between them was lost
HIDDEN = 3.0  # the same, from which interpolated angles are no measurement
ENOUGH = 8  # measured values in a segment: of fewer, the mean square of noise alone exceeds 2 (`no_gap`) in 5 % of them


@dataclass(frozen=True, eq=False)
class Segments:
    """One log as S segments of n ticks with b bins each; a measured axes.

    commands      (T, N_COMMANDS) constant over each tick
    begin         (S,) first tick of each segment; the state there is known, but for the first (`valid`)
    angles        (T, a) [rad] as measured, gaps interpolated
    hidden        (T,) whether in a gap of the samples of more than HIDDEN periods, where `angles` hide motion
    start         (T, 6) smoothed angles and velocities [rad, rad/s] on every tick; NaN: not measured
    measured      (S, b, a) [rad] averaged over bins
    weight        (S, b, a) in comparisons: 0 where samples were lost; above 1 elsewhere in the segment, so that mean
                  squares are those of the measured values
    rest          (3,) [rad] angles when the log began; NaN: unknown
    rests         whether the measured axes were at rest then
    valid         (S,) whether the segment can be used
    rest_from     (S,) the first segment of the rest that a segment continues; of moving ones their own number
    gaps          (g, 2) ticks of the last command before and the first after each short gap in the commands
    command_ticks ticks from command to command
    torque_density (N_COMMANDS,) [N^2 m^2 s] of the noise of measured torques that act as commands (torque_noise.py)
    sample_noise  (a,) [rad] standard deviation of one sample
    noise         (a,) [rad] standard deviation of one value of `measured`
    start_noise   (a, 2) [rad], [rad/s] standard deviation of a smoothed state
    """

    log: JointLog
    rate: float  # [Hz] ticks
    origin: float  # [s] of tick 0, on the log's clock
    ticks: int  # n
    every: int  # ticks per bin
    averaged: bool  # over the bin; otherwise its last tick alone
    axes: tuple[int, ...]  # measured ones: 0 link, 1, 2 motors
    commands: Array
    begin: Indices
    angles: Array
    hidden: Mask
    start: Array
    measured: Array
    weight: Array
    rest: Array
    rests: bool
    valid: Array
    rest_from: Indices
    gaps: Indices
    command_ticks: int
    torque_density: Array
    sample_noise: Array
    noise: Array
    start_noise: Array

    def __len__(self) -> int:
        return len(self.begin)

    @cached_property
    def nominal(self) -> Array:
        """(N_PARAMETERS,) parameter row of the nominal device for this rate."""
        return JointPlant.from_device(self.log.device).at_rate(self.rate)

    @property
    def still(self) -> Array:
        """(3,) [rad/s] speed up to which an axis may be at rest: noise of its speed, and SLOW of its typical speed.

        Friction balances the torque on an axis at rest and has the sign of its motion otherwise. With a noisy speed
        taken for motion, friction of random sign hides every cause.
        """
        found = SLOW * np.sqrt(np.mean(np.nan_to_num(self.start[:, 3:]) ** 2, axis=0))
        noise = self.start_noise[:, 1] - START_SPEED  # without the bias of the smoothing, which grows with the motion
        found[list(self.axes)] += np.maximum(noise, 0.0)
        return np.asarray(found)

    def smoothed_noise(self, rng: np.random.Generator) -> Array:
        """(T, 6) a draw of the error of `start` by sensor noise; 0 for axes without an encoder."""
        every = max(1, round(self.rate * float(np.median(np.diff(self.log.measured.time)))))
        window = window_of(max(2, round(max(SMOOTHING, 4.0 * every / self.rate) * self.rate)), len(self.start))
        drawn = np.zeros_like(self.start)
        for axis, sd in zip(self.axes, self.sample_noise, strict=True):
            samples = sd * rng.standard_normal(len(self.start) // every + 2)
            noise = np.interp(np.arange(len(self.start)) / every, np.arange(len(samples)), samples)
            drawn[:, axis] = savgol_filter(noise, window, 2)
            drawn[:, 3 + axis] = savgol_filter(noise, window, 3, deriv=1, delta=1.0 / self.rate)
        return drawn

    @property
    def ticks_per_sample(self) -> float:
        """Ticks that share the noise of one measurement, because angles between samples are interpolated."""
        return max(1.0, self.rate * float(np.median(np.diff(self.log.measured.time))))

    @property
    def since_begin(self) -> Indices:
        """(T,) ticks since the last segment began; between segments, n or more."""
        every = np.arange(len(self.commands))
        return np.asarray(every - self.begin[np.searchsorted(self.begin, every, side="right") - 1])

    @property
    def measured_drive(self) -> bool:
        """Whether measured torques drive the simulation, in place of commands."""
        return bool(measured_columns(self.log))

    @property
    def time(self) -> Array:
        """(S,) [s] beginnings of the segments on the log's clock."""
        return self.origin + self.begin / self.rate


def cut_log(log: JointLog, span: float | None = None, quality: Quality | None = None) -> Segments:
    """The segments of a log; those outside the usable intervals of `quality` are invalid.

    Raises SignalError if nothing drives a simulation of the log, or if it is too short.
    """
    device = log.device
    if not log.drivable:
        raise SignalError(f"{log.name}: neither commands nor motor torques were recorded, nothing can be simulated")
    steps = np.diff(log.measured.time)
    period = float(np.median(steps))
    uniform = float(np.mean(np.abs(steps - period) > 0.1 * period)) < 0.05
    per_sample = max(1, ceil(SLOWEST * period - 1e-6), _commands_per(period, log)) if uniform else 1
    rate = per_sample / period if uniform else 1000.0
    if abs(rate - round(rate)) < 1e-3 * rate:
        rate = float(round(rate))
    origin = _aligned(log, rate)
    grid = origin + np.arange(int((log.measured.time[-1] - origin) * rate + 1e-6) + 1) / rate
    every = per_sample if per_sample > 1 else max(1, round(BIN * rate))
    wanted = span or SPANS[device.drive]
    ticks = min(max(every, round(wanted * rate / every) * every), (len(grid) - 1) // every * every)
    if ticks < 4 * every:
        raise SignalError(f"{log.name}: {log.duration:.3g} s are too short to compare anything")
    axes = (0, *(1 + i for i, seen in enumerate(log.motors_seen) if seen))
    angles, hidden, lost, mixed = _angles(log, grid, axes)
    if not uniform:  # without a period, only gaps that hide motion are lost samples
        lost = np.repeat(_between(grid, quality.sample_gaps if quality else ())[:, None], len(axes), axis=1)
    reach = max(SMOOTHING, 4.0 * period)
    quanta = np.array([quantum(log, axis) for axis in axes])
    averaged = per_sample == 1 and uniform
    known = log_noise(log) if quality is None else quality.noise
    channels = [known.channels["q" if axis == 0 else f"theta_{axis}"] for axis in axes]
    sd = np.array([channel.sd for channel in channels])
    first = angles[: max(2, round(reach * rate)) + 1]
    still = np.ptp(first, axis=0) < START_SPEED * reach + 4.0 * sd  # (a,) the log begins with this axis at rest
    half = max(2, round(reach * rate))
    states, start_sd = smoothed(angles, ~lost, axes, half, quanta, max(1, round(rate * period)))
    states[:, 3:] *= rate
    at_rest = [axes[i] for i in np.flatnonzero(still)]  # a one-sided fit would be less accurate
    states[0, at_rest], states[0, [3 + axis for axis in at_rest]] = np.median(first[:, still], axis=0), 0.0
    start_sd[0, still] = 0.0
    known_start = np.all(start_sd <= START, axis=1)
    if quality is not None:
        known_start &= inside(grid, ticks / rate, quality.usable)
    begin = begins(known_start, ticks, every)
    share = np.full(len(axes), 1.0 / every if averaged else 1.0)  # variance of a bin over that of a sample
    for i in np.flatnonzero(sd > 0.0):
        path = states[:, axes[i]]
        if averaged:
            run = min(ticks, round(SEGMENT * rate))
            share[i] = mean_variance(error_correlation(channels[i], path, every, run))
        else:
            read = error_correlation(channels[i], path[:: max(1, round(rate * period))], mixed.shape[-1])
            compared = (begin[:, None] + np.arange(every, ticks + 1, every)).ravel()
            share[i] = np.mean(variances(mixed[compared, i], read))
    late = known.jitter**2 * np.nanmean(states[:, [3 + axis for axis in axes]] ** 2, axis=0)  # variance by jitter
    noise = np.sqrt(sd**2 * share + late / (every if averaged else 1) + SMALLEST**2)
    sample_noise = np.sqrt(sd**2 + late + SMALLEST**2)
    start_noise = np.stack([START * sample_noise, START * sample_noise / reach + START_SPEED], axis=1)
    cut = np.stack([angles[b : b + ticks + 1] for b in begin])
    valid = known_start[begin]
    rests = bool(still.all())
    unseen = device.drive == "torque" and not all(log.motors_seen)
    if len(begin) > 1 and (not rests or unseen):
        valid[0] = False  # it begins in motion (a one-sided fit of the velocity is too uncertain), or a motor may move
    measured = binned(cut, every, averaged)
    read = binned(np.stack([lost[b : b + ticks + 1].astype(np.float64) for b in begin]), every, averaged) == 0.0
    valid &= read.sum(axis=(1, 2)) >= ENOUGH
    weight = read * np.sqrt(read[0].size / np.maximum(np.sum(read, axis=(1, 2), keepdims=True), 1))
    commands = drive_rows(log, grid)
    gaps, apart = _command_gaps(log, quality, origin, rate, len(grid))
    density = np.zeros(commands.shape[1])
    if columns := measured_columns(log):
        density[columns] = torque_densities(log, known, ticks / rate)[: len(columns)]
    return Segments(
        log, rate, origin, ticks, every, averaged, axes, commands, begin, angles, hidden, states, measured,
        weight, _rest(log), rests, valid, rest_from(cut, 2.0 * RESTING * sd + quanta), gaps, apart, density,
        sample_noise, noise, start_noise,
    )  # fmt: skip


def cut_with_noise(log: JointLog, noise: LogNoise) -> Segments:
    """The segments of a log that can be used as a whole and whose noise is known. Raises SignalError as `cut_log`."""
    whole = (float(log.measured.time[0]), float(log.measured.time[-1]))
    return cut_log(log, quality=Quality(log, (), (whole,), noise))


def _command_gaps(
    log: JointLog, quality: Quality | None, origin: float, rate: float, ticks: int
) -> tuple[Indices, int]:
    """Short gaps (g, 2) in the commands in ticks, and ticks from command to command."""
    driven = log.motors_commanded or not log.device.n_motors  # by commands, not by measured torques
    if quality is None or not quality.command_gaps or log.commands is None or not driven:
        return np.empty((0, 2), dtype=np.intp), 1
    apart = max(1, round(float(np.median(np.diff(log.commands.time))) * rate))
    gaps = np.round((np.array(quality.command_gaps) - origin) * rate).astype(np.intp)
    return gaps[(gaps[:, 0] >= 0) & (gaps[:, 1] + apart < ticks) & (gaps[:, 1] > gaps[:, 0])], apart


def lined(segments: Segments, late: float) -> Segments:
    """The same with commands interpolated linearly and delayed by `late` [s] (`via_gap.logs.between`)."""
    log, grid = in_lines(segments.log, late), segments.origin + np.arange(len(segments.commands)) / segments.rate
    return replace(segments, log=log, commands=drive_rows(log, grid))


def whole_log(log: JointLog, quality: Quality | None = None) -> Segments:
    """The whole log as one segment: a free run from its first sample. Raises SignalError as `cut_log` does.

    The start counts as exact, because otherwise much of the error would be attributed to it. `quality` is not used.
    """
    segments = cut_log(log, log.duration)
    return replace(segments, start_noise=np.zeros_like(segments.start_noise))


def binned(angles: Array, every: int, averaged: bool) -> Array:
    """Angles per tick (..., n + 1, a) -> per bin of `every` ticks (..., b, a): their mean, or the last one."""
    end = 1 + (angles.shape[-2] - 1) // every * every
    if not averaged:
        return angles[..., every:end:every, :]
    return np.asarray(sum(angles[..., 1 + tick : end : every, :] for tick in range(every)) / every)


def _between(grid: Array, gaps: Sequence[tuple[float, float]]) -> Mask:
    """(T,) whether each tick of `grid` lies inside one of the gaps (begin, end) [s], which do not overlap."""
    begin, end = np.array(gaps).reshape(-1, 2).T
    before = np.searchsorted(begin, grid, side="left")  # gaps that begin earlier
    return before > np.searchsorted(end, grid, side="right")


def _rest(log: JointLog) -> Array:
    """(3,) [rad] median of the first samples of each axis, also of encoders that are not used."""
    rest = np.full(3, np.nan)
    for axis in range(1 + (log.device.n_motors if "theta" in log.measured else 0)):
        first = angle_of(log, axis)[:FIRST]
        if np.isfinite(first).any():
            rest[axis] = np.nanmedian(first)
    return rest


def _commands_per(period: float, log: JointLog) -> int:
    """Number of commands per period [s] of the samples, which is the number of ticks, so that none is lost."""
    if log.commands is None or len(log.commands) < 2:
        return 1
    apart = max(float(np.median(np.diff(log.commands.time))), 1.0 / FASTEST)
    return round(period / apart)


def _aligned(log: JointLog, rate: float) -> float:
    """[s] first tick, at or after the first sample, such that commands change on ticks."""
    first = float(log.measured.time[0])
    if log.commands is None or len(log.commands) < 2:
        return first
    phases = np.exp(2j * np.pi * ((log.commands.time - first) * rate % 1.0))
    mean = np.mean(phases)
    if abs(mean) < 0.9:  # commands are not periodic
        return first
    phase = float(np.angle(mean) / (2.0 * np.pi) % 1.0)
    return first if phase > 1.0 - ROUNDED else first + phase / rate  # 1 by rounding errors is 0


def _angles(log: JointLog, grid: Array, axes: Sequence[int]) -> tuple[Array, Mask, Mask, Array]:
    """Angles (T, a) [rad] on the grid; whether hidden (T,), and whether a sample is lost (T, a).

    Last the interpolation weights (T, a, 4) of the samples in these angles. Before the first and after the last
    measurement of an axis its angle is not known either.
    """
    values = np.empty((len(grid), len(axes)))
    hidden, lost = np.zeros(len(grid), dtype=bool), np.zeros(values.shape, dtype=bool)
    weights = np.empty((*values.shape, 4))
    for i, axis in enumerate(axes):
        column = angle_of(log, axis)
        there = np.isfinite(column)
        time = log.measured.time[there]
        period = float(np.median(np.diff(time)))
        values[:, i], weights[:, i] = interpolated(time, column[there], grid, LOST * period)
        after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
        span = time[after] - time[after - 1]
        beside = np.minimum(np.abs(time[after] - grid), np.abs(grid - time[after - 1]))
        outside = (grid < time[0]) | (grid > time[-1])
        hidden |= np.where(outside, beside, span) > HIDDEN * period
        lost[:, i] = (outside | (span > LOST * period)) & (beside > 0.25 * min(period, grid[1] - grid[0]))
    return values, hidden, lost, weights
