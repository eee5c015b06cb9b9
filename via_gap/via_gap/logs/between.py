"""What commands and torques did between the samples of a log: held until the next, or on the way to it.

A log as fast as its controller contains every command, each of which acts until the next. One that was thinned out
contains one of many: held until the next sample it acts half a sample too late, and in steps that nobody commanded. A
straight line from each sample to the next is nearer; what acted were steps along it, one for each command that was
sent, which is half a period of the controller later on average. A log does not say which it is. Its own motion does
(`via_gap.selection.between`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from via_core.signals import Array, Signals

from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog

RATE = 1000.0  # [Hz] of steps that stand for a line where a log is simulated freely


def in_lines(log: JointLog, late: float) -> JointLog:
    """The same with commands, and torques that stand for them, on lines from sample to sample, `late` [s]."""
    return replace(log, lined=late)


def period_of(log: JointLog) -> float:
    """[s] from command to command, or from torque to torque where those stand for commands."""
    time = log.measured.time if log.commands is None or len(log.commands) < 2 else log.commands.time
    return float(np.median(np.diff(time)))


def acting(log: JointLog, time: Array | None = None) -> Signals | None:
    """The commands as they act: as recorded, or steps along their lines, one from each of the even `time` (N,) on."""
    commands = log.commands
    if log.lined is None or commands is None or len(commands) < 2:
        return commands
    if time is None:
        time = np.arange(commands.time[0], commands.time[-1], 1.0 / RATE)
    middle = time + 0.5 * (time[1] - time[0]) - log.lined
    channels = {name: along(middle, commands.time, values) for name, values in commands.channels.items()}
    return Signals(time, channels, commands.units, commands.held)


def along(time: Array, known: Array, values: Array) -> Array:
    """Values (N, ...) at `known` on lines between them, at `time`."""
    columns = [np.interp(time, known, column) for column in values.reshape(len(values), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])


def told(log: JointLog) -> Finding:
    """What to say of a log that lines explain better."""
    late = 1e3 * (log.lined or 0.0)
    text = (
        "commands go on between the samples of the log: lines from one to the next, "
        f"{late:.2g} ms late, explain the motion clearly better than steps. A controller with a period of "
        f"{2.0 * late:.2g} ms does that, or a delay of {late:.2g} ms: record at the rate of the controller"
    )
    return Finding(log=log.name, check="between samples", signal="commands", severity="note", value=late, text=text)
