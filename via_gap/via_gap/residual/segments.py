"""Short segments of a log, as in multiple shooting: where each starts, what was commanded, what was measured.

A torque-driven joint that is simulated from the first sample drifts off for any small error and is uninformative after
a second. Restarted every quarter of a second, the simulation shows what the model lacks in that segment (rollout.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from via_core.errors import SignalError
from via_core.signals import Array
from via_sim.simulate import command_rows
from via_sim.torques import EXTERNAL, N_COMMANDS

from via_gap.logs.between import acting, along, in_lines
from via_gap.logs.checks import step_of
from via_gap.logs.log import JointLog
from via_gap.logs.noise import error_correlation, log_noise
from via_gap.logs.quality import Quality
from via_gap.logs.replay import FIRST_SAMPLES
from via_gap.logs.rounding import between, mean_variance, slope_order, variances

Indices = NDArray[np.intp]
SPAN = 0.25  # [s] of a segment of a torque-driven joint, which drifts
# [s] by the drive. Under a position drive a wrong start fades within its loop's settling time; of motors that follow
# their commands a joint does not drift at all.
SPANS = {"torque": SPAN, "position": 0.75, "servo": 1.5}
# [Hz] ticks: a slower log is simulated with several ticks per sample, one for each command up to FASTEST, which no
# joint follows
SLOWEST, FASTEST = 500.0, 2000.0
BIN = 0.004  # [s] over which angles are averaged before they are compared
START, START_SPEED = 2.0, 0.03  # times the sensor's noise; [rad/s]: how well a smoothed start is known, bias included
SMOOTHING = 0.012  # [s] to either side of a start over which angle and velocity are fitted
BESIDE_MOTORS = ("damping", "external_torque", "neighbour", "arm_torque")  # commands that do not drive motors
ROUNDED = 1e-6  # of a tick
SMALLEST = 1e-6  # [rad] of a noise
EDGE = 1e-3  # [s] by which a segment may leave a stretch that can be used
LOST = 1.5  # periods from a sample to the next: one between them was lost
RESTS = 0.01  # [rad] within which an axis rests when a log begins


@dataclass(frozen=True, eq=False)
class Segments:
    """One log as S segments of n ticks; b bins per segment, a axes that were seen.

    commands  (T, N_COMMANDS) held over each tick
    begin     (S,) first tick of each segment
    angles    (T, a) [rad] as measured, gaps bridged
    start     (T, 6) smoothed angles and velocities [rad, rad/s] on every tick; NaN: not seen
    measured  (S, b, a) [rad] averaged over bins
    weight    (S, b, a) of a value in comparisons: 0 where samples were lost, for those that were not a bit over 1, so
              that mean squares are of what was read
    rest      (3,) [rad] where the axes stood when the log began; NaN: nobody knows
    valid     (S,) whether every value of the segment was measured
    reading   (a,) [rad] standard deviation of a reading
    noise     (a,) [rad] of a bin
    start_noise  (a, 2) [rad], [rad/s] of a smoothed state
    """

    log: JointLog
    rate: float  # [Hz] ticks
    origin: float  # [s] of tick 0, on the log's clock
    ticks: int  # n
    every: int  # ticks per bin
    averaged: bool  # over the bin, else its last tick alone
    axes: tuple[int, ...]  # that were seen: 0 link, 1, 2 motors
    commands: Array
    begin: Indices
    angles: Array
    start: Array
    measured: Array
    weight: Array
    rest: Array
    valid: Array
    reading: Array
    noise: Array
    start_noise: Array

    def __len__(self) -> int:
        return len(self.begin)

    @property
    def time(self) -> Array:
        """(S,) [s] at which segments begin, on the log's clock."""
        return self.origin + self.begin / self.rate


def cut_log(log: JointLog, span: float | None = None, quality: Quality | None = None) -> Segments:
    """The segments of a log, those valid that lie in stretches that `quality` lets use.

    Raises SignalError where the log has no drive to simulate with, or is too short.
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
    angles, missing, bridged, mixed = _angles(log, grid, axes)
    begin = np.arange(0, len(grid) - ticks, ticks, dtype=np.intp)
    reach = max(SMOOTHING, 4.0 * period)
    quanta = np.array([quantum(log, axis) for axis in axes])
    states = _smoothed(angles, axes, rate, reach, quanta, max(1, round(rate * period)))
    averaged = per_sample == 1 and uniform
    known = log_noise(log) if quality is None else quality.noise
    channels = [known.channels["q" if axis == 0 else f"theta_{axis}"] for axis in axes]
    sd = np.array([channel.sd for channel in channels])
    share = np.full(len(axes), 1.0 / every if averaged else 1.0)  # of a reading's variance in what is compared
    for i in np.flatnonzero(sd > 0.0):
        path = states[:, axes[i]]
        if averaged:
            run = min(ticks, round(SPAN * rate))
            share[i] = mean_variance(error_correlation(channels[i], path, every, run))
        else:
            read = error_correlation(channels[i], path[:: max(1, round(rate * period))], mixed.shape[-1])
            compared = (begin[:, None] + np.arange(every, ticks + 1, every)).ravel()
            share[i] = np.mean(variances(mixed[compared, i], read))
    late = known.jitter**2 * np.nanmean(states[:, [3 + axis for axis in axes]] ** 2, axis=0)  # of uncertain stamps
    noise = np.sqrt(sd**2 * share + late / (every if averaged else 1) + SMALLEST**2)
    reading = np.sqrt(sd**2 + late + SMALLEST**2)
    sure = np.stack([START * reading, START * reading / reach + START_SPEED], axis=1)
    cut = np.stack([angles[b : b + ticks + 1] for b in begin])
    valid = np.array([missing[b : b + ticks + 1].mean() < 0.02 for b in begin])
    if len(begin) > 1 and np.any(np.ptp(angles[: max(2, round(reach * rate)) + 1], axis=0) >= RESTS):
        valid[0] = False  # the log begins in motion: a one-sided fit does not know how fast
    if quality is not None:
        valid &= _inside(origin + begin / rate, ticks / rate, quality.usable)
    measured = binned(cut, every, averaged)
    lost = np.stack([bridged[b : b + ticks + 1].astype(np.float64) for b in begin])
    read = (binned(lost, every, averaged) == 0.0) | (not uniform)  # without a clock nobody knows what was lost
    weight = read * np.sqrt(read[0].size / np.maximum(np.sum(read, axis=(1, 2), keepdims=True), 1))
    drive = _drive(log, grid)
    return Segments(
        log,
        rate,
        origin,
        ticks,
        every,
        averaged,
        axes,
        drive,
        begin,
        angles,
        states,
        measured,
        weight,
        _rest(log),
        valid,
        reading,
        noise,
        sure,
    )


def lined(segments: Segments, late: float) -> Segments:
    """The same with commands on lines from sample to sample, `late` [s] (`via_gap.logs.between`)."""
    log, grid = in_lines(segments.log, late), segments.origin + np.arange(len(segments.commands)) / segments.rate
    return replace(segments, log=log, commands=_drive(log, grid))


def _inside(begin: Array, span: float, usable: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """(S,) whether segments that begin at `begin` [s] lie within one of the intervals."""
    within = [(low - EDGE <= begin) & (begin + span <= high + EDGE) for low, high in usable]
    return np.any(within, axis=0) if within else np.zeros(len(begin), dtype=np.bool_)


def whole_log(log: JointLog, quality: Quality | None = None) -> Segments:
    """The whole log as one segment, from its first sample: a free run. Raises SignalError as `cut_log` does.

    Such a log is compared as it is: of errors beyond the sensors' most would else be put down to the start.
    """
    segments = cut_log(log, log.duration)
    return replace(segments, start_noise=np.zeros_like(segments.start_noise))


def binned(angles: Array, every: int, averaged: bool) -> Array:
    """(..., n + 1, a) angles per tick -> (..., b, a) per bin of `every` ticks: their mean, or the last of them."""
    bins = (angles.shape[-2] - 1) // every
    moved = angles[..., 1 : 1 + bins * every, :]
    cut = moved.reshape(*moved.shape[:-2], bins, every, moved.shape[-1])
    return cut.mean(axis=-2) if averaged else cut[..., -1, :]


def quantum(log: JointLog, axis: int) -> float:
    """[rad] the encoder's step: the file's, or the grid the readings stand on where that is coarser."""
    sensors = log.device.sensors
    told = (sensors.link_quantum if axis == 0 else sensors.motor_quantum) or 0.0
    return max(told, step_of(log.measured["q"] if axis == 0 else log.measured["theta"][:, axis - 1]))


def _rest(log: JointLog) -> Array:
    """(3,) [rad] median of the first samples of each axis, whatever else its encoder does later."""
    rest = np.full(3, np.nan)
    rest[0] = np.nanmedian(log.measured["q"][:FIRST_SAMPLES])
    if "theta" in log.measured:
        for i, column in enumerate(log.measured["theta"][:FIRST_SAMPLES].T):
            if np.isfinite(column).any():
                rest[1 + i] = np.nanmedian(column)
    return rest


def _commands_per(period: float, log: JointLog) -> int:
    """Commands in a sample's period [s]: each holds for a tick, and one between two ticks would be lost."""
    if log.commands is None or len(log.commands) < 2:
        return 1
    apart = max(float(np.median(np.diff(log.commands.time))), 1.0 / FASTEST)
    return round(period / apart)


def _aligned(log: JointLog, rate: float) -> float:
    """[s] at or after the first sample where the grid of ticks starts, so that commands change on ticks."""
    first = float(log.measured.time[0])
    if log.commands is None or len(log.commands) < 2:
        return first
    phases = np.exp(2j * np.pi * ((log.commands.time - first) * rate % 1.0))
    mean = np.mean(phases)
    if abs(mean) < 0.9:  # commands that keep to no clock
        return first
    phase = float(np.angle(mean) / (2.0 * np.pi) % 1.0)
    return first if phase > 1.0 - ROUNDED else first + phase / rate  # a tick less what rounding took is no tick


def _angles(log: JointLog, grid: Array, axes: Sequence[int]) -> tuple[Array, Array, Array, Array]:
    """Angles (T, a) [rad] on the grid, gaps bridged; where long gaps are (T,), and where samples are lost (T, a).

    Last the weights (T, a, 4) of readings in these angles.
    """
    values = np.empty((len(grid), len(axes)))
    missing = np.zeros(len(grid), dtype=bool)
    bridged = np.zeros(values.shape, dtype=bool)
    weights = np.empty((*values.shape, 4))
    longest = 3.0 * float(np.median(np.diff(log.measured.time)))
    for i, axis in enumerate(axes):
        column = log.measured["q"] if axis == 0 else log.measured["theta"][:, axis - 1]
        there = np.isfinite(column)
        time = log.measured.time[there]
        period = float(np.median(np.diff(time)))
        values[:, i], weights[:, i] = between(time, column[there], grid, LOST * period)
        after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
        span = time[after] - time[after - 1]
        missing |= span > longest
        beside = np.minimum(np.abs(time[after] - grid), np.abs(grid - time[after - 1]))
        bridged[:, i] = (span > LOST * period) & (beside > 0.25 * min(period, grid[1] - grid[0]))
    return values, missing, bridged, weights


def _smoothed(angles: Array, axes: Sequence[int], rate: float, reach: float, quanta: Array, per_sample: int) -> Array:
    """(T, 6) angle of a quadratic and velocity of a quadratic or a cubic, fitted over `reach` [s] to either side.

    A quadratic's slope is wrong by reach^2 / 10 times the third derivative: in quick motion more than a fine encoder's
    steps make of a cubic's. A coarse one's make so much of a cubic's that its first order in a segment does not explain
    to finer encoders beside it what follows.
    """
    half = max(2, round(reach * rate))
    window = _window(half, len(angles))
    read = angles[::per_sample]
    among = _window(max(2, round(reach * rate / per_sample)), len(read))
    states = np.full((len(angles), 6), np.nan)
    for i, axis in enumerate(axes):
        states[:, axis] = savgol_filter(angles[:, i], window, 2)
        order = slope_order(read[:, i], states[::per_sample, axis], quanta[i], among) if quanta[i] > 0.0 else 3
        states[:, 3 + axis] = savgol_filter(angles[:, i], window, order, deriv=1, delta=1.0 / rate)
        begin = angles[:window, i]
        if np.ptp(begin[: half + 1]) < RESTS:  # a one-sided fit knows no speed, a joint at rest has none
            states[0, axis], states[0, 3 + axis] = np.median(begin[: half + 1]), 0.0
    return states


def _window(half: int, count: int) -> int:
    """Ticks of a window of `half` to either side, of `count` that there are: an odd number."""
    return min(2 * half + 1, (count - 1) // 2 * 2 + 1)


def _drive(log: JointLog, grid: Array) -> Array:
    """Command rows (T, 4): what was commanded; where motors were not, the torque measured over each tick."""
    device = log.device
    rows = np.zeros((len(grid), N_COMMANDS))
    if log.commands is not None and len(log.commands):
        whole = acting(log, grid)
        assert whole is not None
        if not log.motors_commanded:
            whole = whole.select([name for name in whole.channels if name in BESIDE_MOTORS])
        if whole.channels:
            rows = command_rows(device, whole, grid)
    if device.n_motors and not log.motors_commanded:
        rows[:, : device.n_motors] = _torque_after(log, grid)
    drive_told = log.commands is not None and "external_torque" in log.commands
    if device.drive == "torque" and not device.n_motors and not drive_told and log.torque_seen:
        rows[:, EXTERNAL] = _torque_after(log, grid)[:, 0]
    return rows


def _torque_after(log: JointLog, grid: Array) -> Array:
    """Torque measured (T, m) over the tick that begins at each of `grid`.

    That of a sample is of the tick before it, or what acted then, with lines between.
    """
    seen = np.isfinite(log.measured["tau"]).all(axis=1)
    time, tau = log.measured.time[seen], log.measured["tau"][seen]
    middle = grid + 0.5 * (grid[1] - grid[0])
    if log.lined is not None:
        return along(middle - log.lined, time, tau)
    return tau[np.clip(np.searchsorted(time, middle), 0, len(time) - 1)]
