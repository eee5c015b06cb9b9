"""Commands that the log lacks for a moment: what may have acted instead, as noise of the simulation.

A command that was not recorded either acted or was never sent. In the first case it was anywhere between its two
neighbours, give or take the usual step from one command to the next; in the second the last one stayed. So each gap
has a pulse of unknown size with standard deviation sqrt(d^2 / 3 + s^2), with d the difference of its neighbours and s
the usual step. Its effect on a segment, by simulation, joins that of the unknown start (rollout.py).
"""

from __future__ import annotations

import numpy as np
from via_core.signals import Array

from via_gap.residual.segments import Segments

GROUPS = 8  # gaps in a segment with pulses of their own; more share one, with random signs


def gap_pulses(segments: Segments) -> Array:
    """(G, T, N_COMMANDS) changes of the commands by one standard deviation: neighbouring gaps in different groups."""
    gaps, commands = segments.gaps, segments.commands
    period = segments.command_ticks
    if not len(gaps):
        return np.empty((0, *commands.shape))
    usual = np.abs(commands[period:] - commands[:-period])
    usual = np.sqrt(np.mean(np.minimum(usual, 3.0 * np.median(usual, axis=0)) ** 2, axis=0))  # without jumps
    count = min(GROUPS, int(np.bincount(np.searchsorted(segments.begin, gaps[:, 0], side="right")).max()))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), len(gaps))
    out = np.zeros((count, *commands.shape))
    for k, (begin, end) in enumerate(gaps):
        last = min(end + period, len(commands) - 1)  # the command after the gap may have acted later than its stamp
        step = commands[last] - commands[begin]
        out[k % count, begin + period : last] = signs[k] * np.sqrt(step**2 / 3.0 + usual**2)
    return out
