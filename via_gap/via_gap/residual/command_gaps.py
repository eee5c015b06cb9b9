"""Commands that the log lacks for a moment: what may have acted instead, as noise of the simulation.

A command that is not in the log was either sent but not recorded, or never sent. In the first case it was anywhere
between its two neighbours, give or take the usual step from one command to the next. In the second case the last
command remained. The simulation keeps the last command. Let the change d between the neighbours come at any time in the
gap, and divide the gap into n pieces. The mean error of the command in each piece then has the second moments

    C_ij = d^2 (min(i, j) - 1/2) / n,   C_ii = d^2 (i - 2/3) / n,   i, j = 1 .. n

to which the variance s^2 of the usual step is added in each piece. With C = d^2 V L V', pulse k has the heights
V_ik sqrt(d^2 L_k + s^2) in the pieces i, with unknown sign. A gap of one piece has one pulse of sqrt(d^2 / 3 + s^2).

If a controller is faster than the log, commands between two samples are not recorded (logs/between.py). A step of d
came at any time in the interval T between its samples. The simulation has it halfway, so its integral is wrong by d T
times a number that is uniform from -1/2 to 1/2. Half of that variance is in a pulse before the middle, half in one
after it, each of sd d / sqrt(6). There are two pulses because a drive at its torque limit responds to only one of them.

If the log has every command, its stamps may still be wrong: they show when a sample was written, not when the command
was sent. A periodic sender shows the standard deviation s of this error (`stamp_jitter`). The integral of a step of d
is then wrong by d s. Half of that variance is in a pulse before its stamp, half in one after it.

The simulated response of a segment to each pulse is added to the uncertainty of its start (rollout.py).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from via_core.signals import Array, Indices

from via_gap.logs.between import steps_of, usual
from via_gap.logs.noise import stamp_jitter
from via_gap.logs.quality import SEGMENT, SHORT
from via_gap.residual.driven import drive_rows, measured_columns
from via_gap.residual.segments import ROUNDED, Segments

NO_JITTER = 0.01  # of a tick: errors of stamps by rounding alone are smaller
GROUPS = 8  # gaps in a segment with pulses of their own, the largest; others share one, with random signs
PIECE = SHORT * SEGMENT  # [s] of a gap: the motion depends on the mean of what acted in it


@dataclass(frozen=True, eq=False)
class _Pulse:
    """Changes `sizes` (n, N_COMMANDS) of the commands from each of `edges` (n + 1,) [ticks] to the next."""

    edges: Indices
    sizes: Array


def gap_pulses(segments: Segments) -> Array:
    """(G, T, N_COMMANDS) changes of the commands by one standard deviation: pulses of a segment in different groups."""
    commands = segments.commands
    pulses = [pulse for pulse in (*_lost(segments), *_steps(segments)) if pulse.sizes.any()]
    if not pulses:
        return np.empty((0, *commands.shape))
    squares = np.stack([np.sum(pulse.sizes**2, axis=0) for pulse in pulses])
    largest = np.argsort(-np.sum(squares / (np.mean(squares, axis=0) + np.finfo(float).tiny), axis=1), kind="stable")
    segment = np.searchsorted(segments.begin, [pulse.edges[0] for pulse in pulses], side="right")
    count = min(GROUPS, int(np.bincount(segment).max()))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), len(pulses))
    met = np.zeros(int(segment.max()) + 1, dtype=np.intp)
    out = np.zeros((count, *commands.shape))
    for k in largest:
        group = min(met[segment[k]], count - 1)
        met[segment[k]] += 1
        begin, end = pulses[k].edges[[0, -1]]
        out[group, begin:end] += signs[k] * np.repeat(pulses[k].sizes, np.diff(pulses[k].edges), axis=0)
    return out


def _lost(segments: Segments) -> Iterator[_Pulse]:
    """Pulses where no command was recorded."""
    commands, period = segments.commands, segments.command_ticks
    step = usual(np.abs(commands[period:] - commands[:-period]))
    for before, after in segments.gaps:
        begin, end = before + period, min(after + period, len(commands) - 1)  # the next may act after its stamp
        change = commands[end] - commands[before]
        n = ceil((after - before) / (PIECE * segments.rate) - ROUNDED)
        place = np.arange(1, n + 1)
        moments = np.minimum.outer(place, place) - 0.5
        np.fill_diagonal(moments, place - 2.0 / 3.0)
        values, vectors = np.linalg.eigh(moments / n)
        edges = np.linspace(begin, end, n + 1).round().astype(np.intp)
        for value, vector in zip(values, vectors.T, strict=True):
            yield _Pulse(edges, vector[:, None] * np.sqrt(change**2 * value + step**2))


def _steps(segments: Segments) -> Iterator[_Pulse]:
    """Pulses before and after the middle of each step between two samples, or before and after its wrong stamp."""
    log = segments.log
    if log.commands is None or len(log.commands) < 3:
        return
    time = log.commands.time
    rows = drive_rows(replace(log, lined=None), time)
    rows[:, measured_columns(log)] = 0.0
    if log.lined is None:
        yield from _late(segments, time, steps_of(rows))
        return
    edges = np.sort(np.concatenate((time, 0.5 * (time[1:] + time[:-1])))) + log.lined - segments.origin
    ticks = np.clip(np.floor(edges * segments.rate + 0.5), 0.0, len(segments.commands)).astype(np.intp)
    length = np.diff(ticks).astype(float)
    whole = np.repeat(length[::2] + length[1::2], 2)
    size = np.sqrt(np.divide(whole, 12.0 * length, out=np.zeros_like(length), where=length > 0.0))
    sizes = np.repeat(steps_of(rows), 2, axis=0) * size[:, None]
    for k in np.flatnonzero(sizes.any(axis=1)):
        yield _Pulse(ticks[k : k + 2], sizes[k : k + 1])


def _late(segments: Segments, time: Array, steps: Array) -> Iterator[_Pulse]:
    """Pulses for the steps (N - 1, N_COMMANDS) between commands at times (N,) [s] whose stamps are wrong."""
    jitter = stamp_jitter(time)
    if jitter * segments.rate <= NO_JITTER:
        return
    at = np.round((time[1:] - segments.origin) * segments.rate).astype(np.intp)
    for k in np.flatnonzero(np.any(steps != 0.0, axis=1) & (at > 0) & (at < len(segments.commands))):
        size = steps[k : k + 1] * jitter * segments.rate / np.sqrt(2.0)
        yield _Pulse(np.array([at[k] - 1, at[k]]), size)
        yield _Pulse(np.array([at[k], at[k] + 1]), size)
