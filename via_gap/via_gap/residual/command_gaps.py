"""Commands that the log lacks for a moment: what may have acted instead, as noise of the simulation.

A command that was not recorded either acted or was never sent. In the first case it was anywhere between its two
neighbours, give or take the usual step from one command to the next; in the second the last one stayed. So each gap
has a pulse of unknown size with standard deviation sqrt(d^2 / 3 + s^2), with d the difference of its neighbours and s
the usual step.

Where a controller is faster than the log, commands between two samples are not recorded (logs/between.py). A step of d
came at any time in the interval T between its samples. The simulation has it halfway, and its integral is wrong by d T
times a number that is uniform from -1/2 to 1/2. Half of that variance is in a pulse before the middle, half in one
after it, each of sd d / sqrt(6): a drive at its torque limit responds to one of them alone.

Where the log has every command, its stamps may still be wrong: they say when a sample was written, not when the command
was sent. A periodic sender shows by how much: the stamps differ from a smooth clock with standard deviation s. The
integral of a step of d is then wrong by d s, half of that variance in a pulse before its stamp and half in one after
it.

The effect of each pulse on a segment, by simulation, joins that of the unknown start (rollout.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from via_core.signals import Array, Indices

from via_gap.logs.between import steps_of, usual
from via_gap.logs.noise import clock_of
from via_gap.residual.segments import Segments, drive_rows, measured_columns

NO_JITTER = 0.01  # of a tick
GROUPS = 8  # gaps in a segment with pulses of their own, the largest; others share one, with random signs


def gap_pulses(segments: Segments) -> Array:
    """(G, T, N_COMMANDS) changes of the commands by one standard deviation: gaps of a segment in different groups."""
    commands = segments.commands
    lost, steps = _lost(segments), _steps(segments)
    spans, sizes = (np.concatenate(each) for each in zip(lost, steps, strict=True))
    kept = sizes.any(axis=1)
    spans, sizes = spans[kept], sizes[kept]
    if not len(spans):
        return np.empty((0, *commands.shape))
    scale = np.sqrt(np.mean(sizes**2, axis=0)) + np.finfo(float).tiny
    largest = np.argsort(-np.sum((sizes / scale) ** 2, axis=1), kind="stable")
    segment = np.searchsorted(segments.begin, spans[:, 0], side="right")
    count = min(GROUPS, int(np.bincount(segment).max()))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), len(spans))
    met = np.zeros(int(segment.max()) + 1, dtype=np.intp)
    out = np.zeros((count, *commands.shape))
    for k in largest:
        group = min(met[segment[k]], count - 1)
        met[segment[k]] += 1
        begin, end = spans[k]
        out[group, begin:end] += signs[k] * sizes[k]
    return out


def _lost(segments: Segments) -> tuple[Indices, Array]:
    """Ticks (g, 2) without the commands that were sent, and standard deviations (g, N_COMMANDS) of these."""
    gaps, commands, period = segments.gaps, segments.commands, segments.command_ticks
    step = usual(np.abs(commands[period:] - commands[:-period]))
    last = np.minimum(gaps[:, 1] + period, len(commands) - 1)  # the command after it may have acted after its stamp
    change = commands[last] - commands[gaps[:, 0]]
    return np.stack([gaps[:, 0] + period, last], axis=1), np.sqrt(change**2 / 3.0 + step**2)


def _steps(segments: Segments) -> tuple[Indices, Array]:
    """Ticks (g, 2) before and after the middle of each step, and sd (g, N_COMMANDS) of the commands there."""
    log = segments.log
    if log.commands is None or len(log.commands) < 3:
        return np.empty((0, 2), dtype=np.intp), np.empty((0, segments.commands.shape[1]))
    time = log.commands.time
    rows = drive_rows(replace(log, lined=None), time)
    rows[:, measured_columns(log)] = 0.0
    if log.lined is None:
        return _late(segments, time, steps_of(rows))
    edges = np.sort(np.concatenate((time, 0.5 * (time[1:] + time[:-1])))) + log.lined - segments.origin
    ticks = np.clip(np.floor(edges * segments.rate + 0.5), 0.0, len(segments.commands)).astype(np.intp)
    halves = np.stack([ticks[:-1], ticks[1:]], axis=1)
    length = np.diff(ticks).astype(float)
    whole = np.repeat(length[::2] + length[1::2], 2)
    size = np.sqrt(np.divide(whole, 12.0 * length, out=np.zeros_like(length), where=length > 0.0))
    return halves, np.repeat(steps_of(rows), 2, axis=0) * size[:, None]


def _late(segments: Segments, time: Array, steps: Array) -> tuple[Indices, Array]:
    """The same for commands at times (N,) whose stamps are wrong, and the steps (N - 1, N_COMMANDS) between them."""
    jitter = clock_of(time).jitter
    there = np.flatnonzero(np.any(steps != 0.0, axis=1)) if jitter * segments.rate > NO_JITTER else np.empty(0, np.intp)
    at = np.round((time[1:][there] - segments.origin) * segments.rate).astype(np.intp)
    inside = (at > 0) & (at < len(segments.commands))
    there, at = there[inside], at[inside]
    spans = np.concatenate((np.stack([at - 1, at], axis=1), np.stack([at, at + 1], axis=1)))
    sizes = steps[there] * jitter * segments.rate / np.sqrt(2.0)
    return spans, np.concatenate((sizes, sizes))
