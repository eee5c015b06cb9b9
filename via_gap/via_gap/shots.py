"""A log cut into short shots: each simulated from the measured state, compared with what was measured from there on.

A torque-driven joint run freely under recorded torques drifts off for any small error, and says nothing after a second.
Restarted every quarter of a second it says what the model lacks *there*. Between two shots only angles and velocities
of the axes that were seen are set anew, and what bristles and slipping springs hold after such a motion (memory.py);
what else the state holds (commands under way, angles that nobody measured) goes on. Where a shot starts is known only
as well as the sensors tell: what a wrong start does (to first order, by runs that start beside it) is correlated noise
of the shot, and every comparison is whitened by it,

    e' (1 + A S A')^-1 e = |w|^2,   w = e - U (1 - 1 / sqrt(1 + s^2)) U' e,   U s V' = A S^1/2

with the error e in units of the noise, A the sensitivities, S the variances of the start. A start of which nothing is
known would be projected out, a certain one ignored.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from via_core.errors import SignalError
from via_core.signals import Array
from via_sim.catalogue import MAX_DELAY
from via_sim.lockstep import LANES, run_many
from via_sim.parameters import DYNAMIC, SERVO, P
from via_sim.plants import JointPlant
from via_sim.readings import stride, true_angle
from via_sim.simulate import command_rows
from via_sim.torques import EXTERNAL, HISTORY, N_COMMANDS, QUEUED, X

from via_gap.data_check import step_of
from via_gap.log import JointLog
from via_gap.memory import HELD, held_along, with_memory
from via_gap.replayed import FIRST_SAMPLES
from via_gap.rounding import between, correlation, mean_variance, slope_order, variances

Indices = NDArray[np.intp]
SPAN = 0.25  # [s] of a shot of a torque-driven joint
SERVO_SPAN = 1.5  # [s] of one whose motors follow their commands: it does not drift
SLOWEST = 500.0  # [Hz] ticks; a slower log is simulated with several ticks per sample
BIN = 0.004  # [s] over which angles are averaged before they are compared
START, START_SPEED = 2.0, 0.03  # times the sensor's noise; [rad/s]: how well a smoothed start is known, bias included
SMOOTHING = 0.012  # [s] to either side of a start over which angle and velocity are fitted
BESIDE_MOTORS = ("damping", "external_torque", "neighbour", "arm_torque")  # commands that do not drive motors
ROUNDED = 1e-6  # of a tick
LOST = 1.5  # periods from a sample to the next: one between them was lost
RESTS = 0.01  # [rad] within which an axis rests when a log begins
LEAD = 0.06  # [s] longer than any lag between channels
THREADS = 2


@dataclass(frozen=True, eq=False)
class Shots:
    """One log as S shots of n ticks; b bins per shot, a axes that were seen.

    commands  (T, N_COMMANDS) held over each tick
    begin     (S,) first tick of each shot
    angles    (T, a) [rad] as measured, gaps bridged
    start     (T, 6) smoothed angles and velocities [rad, rad/s] on every tick; NaN: not seen
    measured  (S, b, a) [rad] averaged over bins
    weight    (S, b, a) of a value in comparisons: 0 where samples were lost, for those that were not a bit over 1, so
              that mean squares are of what was read
    rest      (3,) [rad] where the axes stood when the log began; NaN: nobody knows
    valid     (S,) whether every value of the shot was measured
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
        """(S,) [s] at which shots begin, on the log's clock."""
        return self.origin + self.begin / self.rate


def cut_log(log: JointLog, span: float | None = None) -> Shots:
    """The shots of a log. Raises SignalError where it has no drive to simulate with, or is too short."""
    device = log.device
    if not log.drivable:
        raise SignalError(f"{log.name}: neither commands nor motor torques were recorded, nothing can be simulated")
    steps = np.diff(log.measured.time)
    period = float(np.median(steps))
    uniform = float(np.mean(np.abs(steps - period) > 0.1 * period)) < 0.05
    per_sample = max(1, ceil(SLOWEST * period - 1e-6)) if uniform else 1
    rate = per_sample / period if uniform else 1000.0
    if abs(rate - round(rate)) < 1e-3 * rate:
        rate = float(round(rate))
    origin = _aligned(log, rate)
    grid = origin + np.arange(int((log.measured.time[-1] - origin) * rate + 1e-6) + 1) / rate
    every = per_sample if per_sample > 1 else max(1, round(BIN * rate))
    wanted = span or (SPAN if device.drive == "torque" else SERVO_SPAN)
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
    share = np.full(len(axes), 1.0 / every if averaged else 1.0)  # of a reading's variance in what is compared
    for i in np.flatnonzero(quanta > 0.0):
        path = states[:, axes[i]]
        if averaged:
            run = min(ticks, round(SPAN * rate))
            share[i] = mean_variance(correlation(path, quanta[i], every, run))
        else:
            read = correlation(path[:: max(1, round(rate * period))], quanta[i], mixed.shape[-1])
            compared = (begin[:, None] + np.arange(every, ticks + 1, every)).ravel()
            share[i] = np.mean(variances(mixed[compared, i], read))
    noise = np.sqrt(quanta**2 / 12.0 * share + (1e-6) ** 2)
    reading = np.sqrt(quanta**2 / 12.0 + (1e-6) ** 2)
    sure = np.stack([START * reading, START * reading / reach + START_SPEED], axis=1)
    cut = np.stack([angles[b : b + ticks + 1] for b in begin])
    valid = np.array([missing[b : b + ticks + 1].mean() < 0.02 for b in begin])
    measured = binned(cut, every, averaged)
    lost = np.stack([bridged[b : b + ticks + 1].astype(np.float64) for b in begin])
    read = (binned(lost, every, averaged) == 0.0) | (not uniform)  # without a clock nobody knows what was lost
    weight = read * np.sqrt(read[0].size / np.maximum(np.sum(read, axis=(1, 2), keepdims=True), 1))
    drive = _drive(log, grid)
    return Shots(
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


def whole_log(log: JointLog) -> Shots:
    """One shot over all of a log, from where it stood when it began: a free run. Raises SignalError as `cut_log` does.

    Such a log is compared as it is: of errors beyond the sensors' most would else be put down to the start.
    """
    shots = cut_log(log, log.duration)
    return replace(shots, start_noise=np.zeros_like(shots.start_noise))


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
    steps make of a cubic's. A coarse one's make so much of a cubic's that its first order in a shot does not explain
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
        whole = log.commands
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
    """Torque measured (T, m) over the tick that begins at each of `grid`: that of a sample is of the tick before it."""
    seen = np.isfinite(log.measured["tau"]).all(axis=1)
    time, tau = log.measured.time[seen], log.measured["tau"][seen]
    return tau[np.clip(np.searchsorted(time, grid + 0.5 * (grid[1] - grid[0])), 0, len(time) - 1)]


@cache
def _threads() -> ThreadPoolExecutor:
    """One pool for all benches of a process: what a fit asks for takes hardly longer than to start two threads."""
    return ThreadPoolExecutor(THREADS)


os.register_at_fork(after_in_child=_threads.cache_clear)  # threads do not survive a fork


@dataclass(frozen=True, eq=False)
class Bench:
    """Chosen shots of a log, ready to be simulated with any parameter row.

    chosen       indices of shots, ascending
    basis        orthonormal (C, b a, k): what a wrong start does to each shot, in units of the noise
    shrink       (C, k) how much of a residual along each of them is put down to the start
    """

    shots: Shots
    chosen: Indices
    nominal: Array  # (N_PARAMETERS,) row for this rate
    basis: Array = field(init=False)
    shrink: Array = field(init=False)
    lead: int = field(init=False)  # ticks that are simulated before the first shot of a stretch

    def __post_init__(self) -> None:
        object.__setattr__(self, "lead", self.shots.ticks)
        basis, shrink = self._sensitivity(self.nominal)
        object.__setattr__(self, "basis", basis)
        object.__setattr__(self, "shrink", shrink)

    @staticmethod
    def of(shots: Shots, chosen: Indices) -> Bench:
        return Bench(shots, chosen, JointPlant.from_device(shots.log.device).at_rate(shots.rate))

    def part(self, which: Indices) -> Bench:
        """Some of the shots, by their places in `chosen`; where all axes were seen, a short lead is enough for them."""
        other = copy(self)
        object.__setattr__(other, "chosen", self.chosen[which])
        object.__setattr__(other, "basis", self.basis[which])
        object.__setattr__(other, "shrink", self.shrink[which])
        if all(self.shots.log.motors_seen):
            object.__setattr__(other, "lead", min(round(LEAD * self.shots.rate), self.shots.ticks))
        return other

    @property
    def size(self) -> int:
        """Whitened values per shot."""
        return self.shots.measured.shape[1] * len(self.shots.axes)

    def motion(self, rows: Array, offset: Array | None = None, commands: Array | None = None) -> Array:
        """Angles as compared (K, C, b, a) [rad] of rows (K, N_PARAMETERS).

        offset    (6,) is added to every start
        commands  (K, T, N_COMMANDS) of each row, instead of the log's

        Every stretch of neighbouring shots with every row is a run of its own; runs of about one length go in lockstep.
        """
        stretches = self._stretches()
        out = np.empty((len(rows), len(self.chosen), *self.shots.measured.shape[1:]))
        order = np.argsort(-stretches[:, 1], kind="stable")
        runs = np.stack([np.tile(np.arange(len(rows)), len(order)), np.repeat(order, len(rows))], axis=1)
        size = ceil(len(runs) / (THREADS * ceil(len(runs) / (THREADS * LANES))))  # as many on every thread
        pieces = [runs[first : first + size] for first in range(0, len(runs), size)]
        drive = self.shots.commands[None] if commands is None else commands
        held = None  # by elements with memory, where every angle they hang on was seen
        if with_memory(rows).any() and all(self.shots.log.motors_seen):
            held = held_along(rows, self.shots.start[:, :3], self.shots.begin[self.chosen])
        if len(pieces) == 1:
            self._run(rows, offset, drive, held, stretches, pieces[0], out)
            return out
        pool = _threads()  # the kernel releases the GIL
        for job in [pool.submit(self._run, rows, offset, drive, held, stretches, piece, out) for piece in pieces]:
            job.result()
        return out

    def _stretches(self) -> Indices:
        """(n, 2): place in `chosen` of the first shot of each stretch of neighbours, and how many they are."""
        first = np.flatnonzero(np.concatenate(([True], np.diff(self.chosen) != 1)))
        return np.stack([first, np.diff(np.append(first, len(self.chosen)))], axis=1)

    def _run(
        self, rows: Array, offset: Array | None, drive: Array, held: Array | None, stretches: Indices, runs: Indices,
        out: Array,
    ) -> None:  # fmt: skip
        """The `runs` (n, 2), row and stretch each; of one with fewer shots than another the lane ends."""
        shots, axes = self.shots, list(self.shots.axes)
        known = np.array([*axes, *(3 + axis for axis in axes)])
        first, count = stretches[runs[:, 1]].T
        warm = np.maximum(shots.begin[self.chosen[first]] - self.lead, 0)  # before that, nobody knows what is not seen
        sent = drive.reshape(-1, drive.shape[2])
        under = runs[:, 0] % len(drive) * drive.shape[1]  # where each run's commands begin in all that were sent
        states = self._fresh(warm, sent, under)
        ahead = np.flatnonzero(self.chosen[first] > 0)
        if ahead.size:
            begun, moved = states[ahead], np.empty((len(ahead), self.lead + 1, 6))
            run_many(rows[runs[ahead, 0]], begun, sent, under[ahead] + warm[ahead], moved)
            states[ahead] = begun
        moved = np.empty((len(runs), shots.ticks + 1, 6))
        for j in range(int(count.max())):
            left = int(np.sum(count > j))  # runs come longest first
            here, run, state = first[:left] + j, rows[runs[:left, 0]], states[:left]
            begin = shots.begin[self.chosen[here]]
            state[:, known] = self._starts(run, begin)[:, known]
            if held is not None:
                state[:, X.bristle : X.bristle + HELD] = held[runs[:left, 0], here]
            if offset is not None:
                state[:, :6] += offset
            self._remembered(run, begin, state)
            run_many(run, state, sent, under[:left] + begin, moved[:left])
            out[runs[:left, 0], here] = binned(moved[:left][:, :, axes], shots.every, shots.averaged)

    def _fresh(self, ticks: Indices, sent: Array, under: Indices) -> Array:
        """State rows (n, .) at ticks: what was seen, commands under way, motors that were not seen at their command."""
        shots = self.shots
        length = ceil(MAX_DELAY * shots.rate) + 2
        states = np.zeros((len(ticks), X.queue + QUEUED * length))
        states[:, X.tick] = ticks
        known = np.isfinite(shots.rest)
        queue = states[:, X.queue :].reshape(len(ticks), length, QUEUED)
        each = np.arange(len(ticks))
        before = ticks[:, None] - np.arange(1, length + 1)
        queue[each[:, None], before % length] = sent[under[:, None] + np.maximum(before, 0), :QUEUED]
        early, back = np.nonzero(before < 0)
        for axis in (1, 2):  # servos stood where they were before the log began
            if known[axis] and self.nominal[P.axis_kind + axis] == SERVO:
                queue[early, before[early, back] % length, axis - 1] = shots.rest[axis]
        for axis in range(3):
            if axis in shots.axes:
                states[:, [axis, 3 + axis]] = shots.start[ticks][:, [axis, 3 + axis]]
                continue
            if self.nominal[P.axis_kind + axis] == SERVO:
                states[:, axis] = sent[under + ticks, axis - 1]
            elif self.nominal[P.axis_kind + axis] == DYNAMIC:
                states[:, axis] = shots.start[ticks, 0]
            if known[axis]:
                states[ticks == 0, axis] = shots.rest[axis]
        history = states[:, X.history : X.queue].reshape(len(ticks), -1, 6)
        history[:, :, :3] = states[:, None, :3]
        return states

    def _starts(self, rows: Array, ticks: Indices) -> Array:
        """Where shots start (n, 6): as read there, errors that a row gives its encoders undone."""
        shots = self.shots
        states = shots.start[ticks]
        for axis in shots.axes:
            skew, swing = rows[:, P.skew + axis] * shots.rate, rows[:, P.eccentricity + axis]
            late = np.flatnonzero(skew)
            if late.size:
                at = np.minimum(ticks[late] + skew[late], len(shots.start) - 1.0)
                low = at.astype(int)
                share = (at - low)[:, None]
                high = np.minimum(low + 1, len(shots.start) - 1)
                both = [axis, 3 + axis]
                moved = (1.0 - share) * shots.start[low][:, both] + share * shots.start[high][:, both]
                states[late, axis], states[late, 3 + axis] = moved[:, 0], moved[:, 1]
            states[:, axis] = true_angle(rows, axis, states[:, axis])
            if swing.any():
                states[:, 3 + axis] /= 1.0 + swing * np.cos(states[:, axis] + rows[:, P.eccentricity_phase + axis])
        return states

    def _remembered(self, rows: Array, ticks: Indices, states: Array) -> None:
        """Where axes were before shots that start at `ticks` (n,), for encoders that read late, into states (n, .).

        A late encoder's first readings of a shot are of the time before it: as it read then, not as the shot before it
        ran, which ended somewhere else.
        """
        skews = rows[:, [P.skew + axis for axis in self.shots.axes]].max(axis=1)
        late = np.flatnonzero(skews > 0.0)
        if not late.size:
            return
        every = stride(1.0 / self.shots.rate)
        past, history = rows[late], states[late, X.history : X.queue].reshape(len(late), HISTORY, 6)
        known = [*self.shots.axes, *(3 + axis for axis in self.shots.axes)]
        for back in range(min(ceil(float(skews.max()) * self.shots.rate / every) + 2, HISTORY)):
            which = ticks[late] // every - back
            there = self._starts(past, np.maximum(which * every, 0))
            history[np.arange(len(late))[:, None], (which % HISTORY)[:, None], known] = there[:, known]
        states[late, X.history : X.queue] = history.reshape(len(late), -1)

    def _sensitivity(self, row: Array) -> tuple[Array, Array]:
        """Directions and shares for `residual`, by runs that start one standard deviation beside the measured state."""
        steps = []
        for axis, noise in zip(self.shots.axes, self.shots.start_noise, strict=True):
            for slot, size in ((axis, noise[0]), (3 + axis, noise[1])):
                offset = np.zeros(6)
                offset[slot] = size
                steps.append(offset)
        plain = self.motion(row[None])[0]
        columns = np.stack([self.motion(row[None], offset)[0] - plain for offset in steps], axis=-1)
        columns = columns * (self.shots.weight[self.chosen] / self.shots.noise)[..., None]
        flat = columns.reshape(len(self.chosen), self.size, len(steps))
        basis, sizes, _ = np.linalg.svd(np.clip(np.nan_to_num(flat), -1e9, 1e9), full_matrices=False)
        return basis, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)

    def residual(self, rows: Array, commands: Array | None = None) -> Array:
        """Whitened measured minus simulated (K, C, b a), under commands as of `motion`; what overflowed is huge."""
        shots = self.shots
        scale = shots.weight[self.chosen] / shots.noise
        error = (shots.measured[self.chosen] - self.motion(rows, commands=commands)) * scale
        flat = error.reshape(len(rows), len(self.chosen), self.size)
        flat = np.clip(np.nan_to_num(flat, nan=1e8, posinf=1e8, neginf=-1e8), -1e8, 1e8)
        along = self.shrink * np.einsum("crk,Kcr->Kck", self.basis, flat)
        return flat - np.einsum("crk,Kck->Kcr", self.basis, along)
