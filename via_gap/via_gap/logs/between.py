"""Commands and torques between the samples of a log: constant (zero-order hold), or interpolated linearly.

A log at the rate of the controller contains every command, and each acts until the next. A decimated log contains one
of many commands. With a zero-order hold, it would act half a sample too late on average, in steps that were not
commanded. Linear interpolation is closer: the controller sent steps along the line, which are late by half its period
on average. The motion in the log decides between the two (`via_gap.selection.between`).
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from via_core.signals import Array, Signals

from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog

RATE = 1000.0  # [Hz] of the steps that approximate a line in a free simulation
# Standard deviations of the mean delay of commands, in periods of the log, where the motion does not show it. Lines act
# late by half the period of the controller, any number from 0 to a half. Steps that stand for many commands act late by
# half a period at most: that is the end of a 95 % interval.
LATE_SD, STEPS_SD = 0.5 / sqrt(12.0), 0.5 / 1.96


def in_lines(log: JointLog, late: float) -> JointLog:
    """The log with commands, or torques in their place, interpolated linearly and delayed by `late` [s]."""
    return replace(log, lined=late)


def period_of(log: JointLog) -> float:
    """[s] from command to command, or from torque to torque if there are no commands."""
    time = log.measured.time if log.commands is None or len(log.commands) < 2 else log.commands.time
    return float(np.median(np.diff(time)))


def acting(log: JointLog, time: Array | None = None) -> Signals | None:
    """The commands as recorded; interpolated ones as steps along the lines that begin at the even `time` (N,)."""
    commands = log.commands
    if log.lined is None or commands is None or len(commands) < 2:
        return commands
    if time is None:
        time = np.arange(commands.time[0], commands.time[-1], 1.0 / RATE)
    middle = time + 0.5 * (time[1] - time[0]) - log.lined
    channels = {name: along(middle, commands.time, values) for name, values in commands.channels.items()}
    return Signals(time, channels, commands.units, commands.held)


def along(time: Array, known: Array, values: Array) -> Array:
    """Values (N, ...) at times `known`, interpolated linearly at `time`."""
    columns = [np.interp(time, known, column) for column in values.reshape(len(values), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])


def lines_finding(log: JointLog) -> Finding:
    """The finding on a log that interpolated commands explain better."""
    late = log.lined or 0.0
    better = f"linear interpolation, {1e3 * late:.2g} ms late, explains the motion clearly better than steps"
    if late > 0.0 and round(period_of(log) / (2.0 * late)) == 1:  # no command lies between two samples
        text = (
            f"{better} and is as late as steps at the rate of the log: no command is missing; interpolation averages "
            "the noise of stamps and recorded values"
        )
    elif late > 0.0:
        text = (
            f"commands changed between the samples of the log: {better}. The controller has a period of "
            f"{2e3 * late:.2g} ms, or commands are delayed by {1e3 * late:.2g} ms: record at the rate of the controller"
        )
    else:
        text = f"commands changed between the samples of the log: {better}: record at the rate of the controller"
    return log.finding("between samples", "commands", "note", 1e3 * late, text)
