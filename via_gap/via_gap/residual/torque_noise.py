"""Noise of measured torques that drive a simulation, as noise of its motion.

Without recorded commands, the measured torque is the input of the simulated joint, and so is the noise n of its sensor.
To first order, with h the response to a pulse of torque, the error of a segment is

    e(t) = integral h(t - s) n(s) ds

The mean of n over a piece of L seconds has the variance S / L, with the spectral density S. So each piece has a pulse
of one standard deviation. The simulated response of a segment to it is added to the uncertainty of its start
(rollout.py).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from via_core.signals import Array

from via_gap.residual.command_gaps import gap_pulses
from via_gap.residual.segments import Segments

PIECES = 64  # of a segment at most: errors within a piece average out


def command_pulses(segments: Segments) -> Iterator[Array]:
    """All errors (T, N_COMMANDS) of the commands, one standard deviation each: in their gaps, and by torque noise."""
    yield from gap_pulses(segments)
    yield from noise_pulses(segments)


def noise_pulses(segments: Segments) -> Iterator[Array]:
    """Changes (T, N_COMMANDS) of the commands by one standard deviation, each in one piece of every segment."""
    ticks, commands = segments.ticks, segments.commands
    edges = np.linspace(0, ticks, min(PIECES, segments.measured.shape[1]) + 1).round().astype(int)
    piece = np.searchsorted(edges, segments.since_begin, side="right") - 1
    for column in np.flatnonzero(segments.torque_density):
        for k, lasting in enumerate(np.diff(edges) / segments.rate):
            pulse = np.zeros(commands.shape)
            pulse[piece == k, column] = np.sqrt(segments.torque_density[column] / lasting)
            yield pulse
