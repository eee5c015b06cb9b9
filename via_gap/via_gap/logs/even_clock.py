"""Times of samples where the stamps are wrong: those of an even clock.

A driver that samples at an even rate often stamps its samples when they arrive, up to milliseconds apart from it. Fast
motion shows whether it did: with wrong times, the angle departs from a smooth motion by the speed times their error
(`jitter` of `via_gap.logs.noise`). The even clock numbers the samples and smooths their stamps:

    t_n = a + b n + smoothed(stamp_n - a - b n)

Whichever times leave less jitter in the link's angle are used. Samples that were late, with true stamps, keep them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial
from scipy.ndimage import gaussian_filter1d
from via_core.signals import Array

from via_gap.logs.log import JointLog
from via_gap.logs.noise import channel_noise, sample_numbers

SMOOTHED = 25.0  # samples, standard deviation of the Gaussian: errors of single stamps count a ninth


def even_times(time: Array) -> Array:
    """(N,) [s] the even clock of stamps (N,) [s]."""
    number = sample_numbers(time)
    line = Polynomial.fit(number, time, 1)(number)
    return np.asarray(line + gaussian_filter1d(time - line, SMOOTHED, mode="nearest"))


def evened(log: JointLog, jitter: float) -> JointLog:
    """The log on an even clock, if its angle shows less jitter [s] there; otherwise as it is.

    Commands with the stamps of the samples move with them.
    """
    stamps, angle = log.measured.time, log.measured["q"]
    if jitter <= 0.0:
        return log
    time = even_times(stamps)
    filed = log.device.sensors.link_quantum
    if np.any(np.diff(time) <= 0.0) or channel_noise(time, angle, filed).jitter >= jitter:
        return log
    commands = log.commands
    if commands is not None and np.isin(commands.time, stamps).all():
        commands = replace(commands, time=np.interp(commands.time, stamps, time))
    error = float(np.sqrt(np.mean((stamps - time) ** 2)))
    return replace(log, measured=replace(log.measured, time=time), commands=commands, restamped=error)
