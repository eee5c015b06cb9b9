"""Times of samples whose stamps are wrong.

A driver that samples at an even rate often stamps its samples when they arrive, up to milliseconds apart from it. About
each sample, a line through neighbouring stamps is an even clock; d is the stamp less that line. Where samples are lost,
or stamps come in bursts, there is no line, and d is 0: numbers of samples are certain only between neighbours.

A fast motion shows which times are right. The angle at the stamps is q(t) + v d, with v the speed and t the even times.
So d, which is known, is sought in what a smooth motion leaves of the angle, H q, by least squares:

    H q = c H (v d)         c = 1: samples were taken when they were stamped;  c = 0: on the even clock

If samples are late by chance and stamps are wrong besides, c is the share of the first in <d^2>, and t + c d is the
best estimate of the times. It is used if c is known to a quarter, and below 1 by two standard errors or more. They come
from parts of the log with as much motion each, left out in turn, and from that of v, which takes the samples as even.
The noise of two estimates of v, from samples of their own, is independent, so that it does not make c smaller: one of
them is the instrument of the other.

Source: instrumental variables, R. J. Bowden, D. A. Turkington, Instrumental Variables (Cambridge, 1985).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import savgol_coeffs
from via_core.signals import Array, Mask

from via_gap.logs.log import JointLog

NEAR = 0.5  # period by which a step between neighbours differs from it at most
WINDOW, DEGREE = 7, 4  # samples on a line, and degree of the polynomials that a smooth motion follows
SPEED = 0.05  # relative error of v: samples .1 period off an even clock change it by 2 to 4 %
PARTS = 10  # of a log, left out in turn
KNOWN = 0.25  # standard error of c at most: two of them are half of the way from 0 to 1
ERRORS = 2.0  # standard errors


def evened(log: JointLog, noise: float) -> JointLog:
    """The log with the times that its angle shows, if its stamps are wrong; otherwise as it is.

    noise  [rad] of the link's angle; stamps that disturb the angle by less stay

    Commands with the stamps of the samples move with them.
    """
    stamps = log.measured.time
    late, known = unevenness(stamps)
    share, error = share_in(log.measured["q"], stamps / period_of(stamps), known)
    time = stamps - (1.0 - max(share, 0.0)) * late
    if error > KNOWN or share + ERRORS * error >= 1.0:
        return log
    wrong = float(np.sqrt(np.mean((stamps - time)[known] ** 2)))
    if wrong * typical_speed(log) <= noise:
        return log
    commands = log.commands
    if commands is not None and np.isin(commands.time, stamps).all():
        commands = replace(commands, time=np.interp(commands.time, stamps, time))
    return replace(log, measured=replace(log.measured, time=time), commands=commands, restamped=wrong)


def typical_speed(log: JointLog) -> float:
    """[rad/s] of the link: the median of its faster half, where stamps matter."""
    there = np.isfinite(log.measured["q"])
    speed = np.gradient(log.measured["q"][there], log.measured.time[there])
    return float(np.sqrt(np.quantile(speed**2, 0.75)))


def period_of(time: Array) -> float:
    """[s] the mean of those steps of times (N,) [s] that are near the median: steps may alternate."""
    steps = np.diff(time)
    median = np.median(steps)
    return float(np.mean(steps[np.abs(steps - median) <= NEAR * median]))


def unevenness(time: Array) -> tuple[Array, Mask]:
    """(N,) [s] stamps less the line through the window about each, and (N,) whether there is one; else 0.

    There is none within half a window of a step that is no period. Even where steps are .5 and 1.5 periods long,
    |d| is less than the distance to a neighbour: stamps less any share of d increase.
    """
    steps, late, known = np.diff(time), np.zeros(len(time)), np.zeros(len(time), dtype=np.bool_)
    if len(time) < WINDOW:
        return late, known
    period, half = period_of(time), WINDOW // 2
    known[half:-half] = (np.abs(sliding_window_view(steps, WINDOW - 1) - period) <= NEAR * period).all(axis=1)
    late[half:-half] = time[half:-half] - sliding_window_view(time, WINDOW).mean(axis=1)
    return np.where(known, late, 0.0), known


def share_in(angle: Array, stamps: Array, known: Mask) -> tuple[float, float]:
    """Share c of the unevenness of `stamps` (N,) [periods] in angles (N,), and its standard error; see the head.

    Angles that are not finite are left out. The standard error is infinite where no motion shows the share.
    """
    if len(angle) < WINDOW * PARTS:
        return 0.0, np.inf
    there = sliding_window_view(known & np.isfinite(angle), WINDOW).all(axis=1)
    place = np.arange(WINDOW) - WINDOW // 2
    q = sliding_window_view(angle, WINDOW)[there]
    line = stamps - np.arange(len(stamps))  # of numbers; H removes any other line from it
    d = (sliding_window_view(line, WINDOW) - line[WINDOW // 2 : len(line) - WINDOW // 2, None])[there]
    rough = np.eye(WINDOW)[WINDOW // 2] - savgol_coeffs(WINDOW, DEGREE, use="dot")
    one, other = (np.where(place % 2 == odd, place, 0) / np.sum(place[place % 2 == odd] ** 2) for odd in (0, 1))
    left, first, second = q @ rough, ((q @ one)[:, None] * d) @ rough, ((q @ other)[:, None] * d) @ rough
    motion = np.cumsum(first**2 + second**2)
    if not len(motion) or motion[-1] <= 0.0:
        return 0.0, np.inf
    parts = np.searchsorted(motion, motion[-1] * np.arange(1, PARTS) / PARTS)
    both = (left * (first + second), 2.0 * first * second)
    products, squares = (np.array([np.sum(part) for part in np.split(each, parts)]) for each in both)
    if not np.all(np.sum(squares) - squares > 0.0):
        return 0.0, np.inf
    without = (products.sum() - products) / (squares.sum() - squares)
    error = float(np.sqrt((PARTS - 1) / PARTS * np.sum((without - without.mean()) ** 2)))
    share = float(products.sum() / squares.sum())
    return share, float(np.hypot(error, SPEED * share))
