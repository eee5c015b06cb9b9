"""Commands and torques between the samples of a log: constant (zero-order hold), or interpolated linearly.

A log at the rate of the controller contains every command, and each acts until the next. A decimated log contains one
of many commands. With a zero-order hold, it would act half a sample too late on average, in steps that were not
commanded. Linear interpolation is closer: the controller sent steps along the line, which are late by half its period
on average. A single step (a goal that jumps) came at any time between its samples, on average halfway: it stays a step
there, and the unknown time is noise (`via_gap.residual.command_gaps`). The motion in the log decides between hold and
interpolation (`via_gap.selection.between`).
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from via_core.signals import Array, Signals

from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog

OUTLYING = 3.0  # times the usual size
ROUNDED = 1e-6  # of a tick: closer stamps are on its edge
AT_ONCE = 0.05  # sampling periods: shorter delays are not mentioned, because they are not known better
LATE_TORQUES = "torques"  # signal of the finding that measured torques are late
RATE = 1000.0  # [Hz] of the steps that approximate a line in a free simulation
# Standard deviations of the mean delay of commands, in periods of the log, where the motion does not show it. Lines act
# late by half the period of the controller, any number from 0 to a half. Steps that stand for many commands act late by
# half a period at most: that is the end of a 95 % interval.
LATE_SD, STEPS_SD = 0.5 / sqrt(12.0), 0.5 / 1.96


def in_lines(log: JointLog, late: float) -> JointLog:
    """The log with commands, or torques in their place, interpolated linearly and delayed by `late` [s].

    Negative: torques are measured late, and act earlier than recorded.
    """
    return replace(log, lined=late)


def period_of(log: JointLog) -> float:
    """[s] from command to command, or from torque to torque if there are no commands."""
    time = log.measured.time if log.commands is None or len(log.commands) < 2 else log.commands.time
    return float(np.median(np.diff(time)))


def acting(log: JointLog, time: Array | None = None) -> Signals | None:
    """The commands as recorded, or their means over the ticks that begin at `time` (N,).

    Interpolated ones are steps along the lines from tick to tick, which have to be even.
    """
    commands = log.commands
    if commands is None or len(commands) < 2:
        return commands
    if log.lined is None:
        return commands if time is None else _means(commands, time)
    if time is None:
        time = np.arange(commands.time[0], commands.time[-1], 1.0 / RATE)
    late = time - max(log.lined, 0.0)  # measured torques may be late, and are shifted forward; commands are not
    channels = {name: _between(late, commands.time, values) for name, values in commands.channels.items()}
    return Signals(time, channels, commands.units, commands.held)


def _means(commands: Signals, time: Array) -> Signals:
    """The mean over each tick of commands with zero-order hold.

    A command whose stamp lies inside a tick acts for the rest of it. If it waited for the next tick, steps would come
    late by up to one tick, and smooth commands by half a tick on average.
    """
    edges = np.append(time, 2.0 * time[-1] - time[-2])
    length = np.diff(edges)
    after = np.clip(np.searchsorted(edges, commands.time), 1, len(time))
    nearest = after - (commands.time - edges[after - 1] < edges[after] - commands.time)
    on_edge = np.abs(commands.time - edges[nearest]) < ROUNDED * length.min()
    known = np.where(on_edge, edges[nearest], commands.time)
    inside = np.flatnonzero(~on_edge & (known > edges[0]) & (known < edges[-1]))
    begins = np.concatenate((edges[:-1], known[inside]))
    order = np.argsort(begins, kind="stable")
    holds = np.clip(np.searchsorted(known, begins[order], side="right") - 1, 0, len(known) - 1)
    first = np.flatnonzero(order < len(time))  # of the pieces of each tick
    pieces_of = np.diff(first, append=len(order))
    share = np.diff(begins[order], append=edges[-1]) / np.repeat(length, pieces_of)
    divided = pieces_of > 1

    def averaged(values: Array) -> Array:
        pieces = values[holds]
        mean = np.add.reduceat(pieces * share.reshape(-1, *(1,) * (values.ndim - 1)), first, axis=0)
        changed = divided.reshape(-1, *(1,) * (values.ndim - 1)) & np.isfinite(mean)  # not where a drive is off
        return np.where(changed, mean, pieces[first])

    channels = {name: averaged(values) for name, values in commands.channels.items()}
    return Signals(time, channels, commands.units, commands.held)


def steps_of(values: Array) -> Array:
    """Steps (N - 1, ...) between neighbouring values (N, ...), beyond what is usual among them.

    A step is what a difference shares with neither neighbour: nothing on a ramp, almost nothing on a smooth curve, the
    whole difference where values are constant before and after. Noise has it everywhere and is no step.
    """
    change = np.diff(values, axis=0)
    if len(change) < 2:
        return np.zeros_like(change)
    bend = np.abs(np.diff(change, axis=0))  # at the sample between two differences
    own = np.minimum(np.concatenate((bend[:1], bend)), np.concatenate((bend, bend[-1:])))
    own = np.nan_to_num(np.minimum(np.abs(change), own))
    return np.asarray(np.nan_to_num(np.sign(change)) * np.maximum(own - OUTLYING * usual(own), 0.0))


def usual(sizes: Array) -> Array:
    """Root mean square (...,) of sizes (N, ...) >= 0 without the outlying ones."""
    return np.asarray(np.sqrt(np.mean(np.minimum(sizes, OUTLYING * np.median(sizes, axis=0)) ** 2, axis=0)))


def _between(time: Array, known: Array, values: Array) -> Array:
    """Means (N, ...) over the periods that begin at the even `time` of values at times `known`: lines and steps."""
    period, steps = time[1] - time[0], steps_of(values)
    sum_of_steps = np.concatenate((np.zeros_like(values[:1]), np.cumsum(steps, axis=0)))
    smooth = along(time + 0.5 * period, known, values - sum_of_steps)
    middle = 0.5 * (known[1:] + known[:-1])
    knots = np.concatenate((middle, [max(known[-1], time[-1] + period) + period]))
    passed = np.diff(knots).reshape(-1, *(1,) * (values.ndim - 1))
    integral = np.concatenate((np.zeros_like(values[:1]), np.cumsum(sum_of_steps[1:] * passed, axis=0)))
    ends = along(np.append(time, time[-1] + period), knots, integral)
    return np.asarray(smooth + np.diff(ends, axis=0) / period)


def along(time: Array, known: Array, values: Array) -> Array:
    """Values (N, ...) at times `known`, interpolated linearly at `time`."""
    columns = [np.interp(time, known, column) for column in values.reshape(len(values), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])


def lines_finding(log: JointLog) -> Finding:
    """The finding on a log that interpolated commands explain better."""
    late = log.lined or 0.0
    shifted = -late - 0.5 * period_of(log)  # the torque of a sample is that of the period before it
    if shifted > AT_ONCE * period_of(log):
        text = f"the measured torques are {1e3 * shifted:.3g} ms later than the angles, and were shifted by as much"
        return log.finding("between samples", LATE_TORQUES, "note", 1e3 * shifted, text)
    late *= late >= AT_ONCE * period_of(log)
    delay = f", {1e3 * late:.2g} ms late," if late > 0.0 else ""
    better = f"linear interpolation{delay} explains the motion clearly better than steps"
    if late > 0.0 and round(period_of(log) / (2.0 * late)) == 1:  # no command lies between two samples
        text = f"{better}. It is as late as steps at the rate of the log: no command is missing"
    elif late > 0.0:
        text = (
            f"{better}: commands are delayed by {1e3 * late:.2g} ms, or those of a controller with a period of "
            f"{2e3 * late:.2g} ms are missing; record every command"
        )
    else:
        text = f"{better}: commands between the samples are missing, or lines average their noise; record every command"
    return log.finding("between samples", "commands", "note", 1e3 * late, text)
