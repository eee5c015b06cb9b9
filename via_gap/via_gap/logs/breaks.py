"""Breaks of a recording, made short: a pause of the recorder, or a clock that was set.

What happened meanwhile is unknown, and nothing that a diagnosis simulates remembers it. Work and memory grow with the
time between the first and the last sample, so that an hour without a sample would cost more than all samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from via_core.signals import Signals

BREAK = 10.0  # [s] without a sample
LEFT = 2.0  # [s] of a break that remain, longer than any segment


def without_breaks(
    measured: Signals, commands: Signals | None
) -> tuple[Signals, Signals | None, tuple[tuple[float, float], ...]]:
    """The same with short breaks, and begin and length [s] of each break as recorded. Later samples move forward."""
    time, steps = measured.time, np.diff(measured.time)
    found = np.flatnonzero(steps > BREAK)
    if not found.size:
        return measured, commands, ()
    removed = np.where(steps > BREAK, steps - LEFT, 0.0)
    moved = time - np.append(0.0, np.cumsum(removed))
    if commands is not None:
        within = np.interp(commands.time, time, moved)
        beyond = np.maximum(commands.time - time[-1], 0.0) + np.minimum(commands.time - time[0], 0.0)
        commands = replace(commands, time=within + beyond)
    return replace(measured, time=moved), commands, tuple((float(time[i]), float(steps[i])) for i in found)
