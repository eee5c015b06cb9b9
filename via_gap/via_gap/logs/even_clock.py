"""Times of samples where the stamps are wrong: those of an even clock, or between both.

A driver that samples at an even rate often stamps its samples when they arrive, up to milliseconds apart from it. The
even clock numbers the samples and smooths their stamps:

    t_n = a + b n + smoothed(stamp_n - a - b n),      d_n = stamp_n - t_n

A fast motion shows which times are right. The angle at the stamps is q(t_n) + v_n d_n, with v the speed. So d, which is
known, is sought in what a smooth motion over n leaves of the angle, H q, by least squares:

    H q = c H (v d)         c = 1: samples were taken when they were stamped;  c = 0: on the even clock

If samples are late by chance and stamps are wrong besides, c is the share of the first in <d^2>, and t_n + c d_n is the
best estimate of the times. It is used if c is known to a quarter, and below 1 by two standard errors or more. They come
from parts of the log left out in turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Polynomial
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_coeffs
from via_core.signals import Array

from via_gap.logs.log import JointLog
from via_gap.logs.noise import sample_numbers

SMOOTHED = 25.0  # samples, standard deviation of the Gaussian: errors of single stamps count a ninth
WINDOW, DEGREE = 7, 4  # samples and degree of the polynomials that a smooth motion follows
PARTS = 10  # of a log, left out in turn
KNOWN = 0.25  # standard error of c: a larger one shows nothing
ERRORS = 2.0  # standard errors


def evened(log: JointLog) -> JointLog:
    """The log with the times that its angle shows, if its stamps are wrong; otherwise as it is.

    Commands with the stamps of the samples move with them.
    """
    stamps = log.measured.time
    even = even_times(stamps)
    late = (stamps - even) / float(np.median(np.diff(even)))
    share, error = share_in(log.measured["q"], sample_numbers(stamps), late)
    time = even + max(share, 0.0) * (stamps - even)
    if error > KNOWN or share + ERRORS * error >= 1.0 or np.any(np.diff(time) <= 0.0):
        return log
    commands = log.commands
    if commands is not None and np.isin(commands.time, stamps).all():
        commands = replace(commands, time=np.interp(commands.time, stamps, time))
    wrong = float(np.sqrt(np.mean((stamps - time) ** 2)))
    return replace(log, measured=replace(log.measured, time=time), commands=commands, restamped=wrong)


def even_times(time: Array) -> Array:
    """(N,) [s] the even clock of stamps (N,) [s]."""
    number = sample_numbers(time)
    line = Polynomial.fit(number, time, 1)(number)
    return np.asarray(line + gaussian_filter1d(time - line, SMOOTHED, mode="nearest"))


def share_in(angle: Array, number: Array, late: Array) -> tuple[float, float]:
    """Share c of `late` (N,) [samples], stamps less even clock, in angles (N,) of samples `number` (N,); its error.

    Angles that are not finite are left out. The standard error is infinite where no motion shows the share.
    """
    if len(angle) < WINDOW * PARTS:
        return 0.0, np.inf
    windows = [sliding_window_view(each, WINDOW) for each in (angle, number, late)]
    seen = np.isfinite(windows[0]).all(axis=1) & (windows[1][:, -1] - windows[1][:, 0] == WINDOW - 1)
    q, d = windows[0][seen], windows[2][seen]
    rough = np.eye(WINDOW)[WINDOW // 2] - savgol_coeffs(WINDOW, DEGREE, use="dot")
    speed = q @ savgol_coeffs(WINDOW, 2, deriv=1, use="dot")  # [rad] per sample
    left, known = q @ rough, (speed[:, None] * d) @ rough
    products, squares = (
        np.array([np.sum(part) for part in np.array_split(each, PARTS)]) for each in (left * known, known**2)
    )
    if not np.all(np.sum(squares) - squares > 0.0):
        return 0.0, np.inf
    without = (products.sum() - products) / (squares.sum() - squares)
    error = float(np.sqrt((PARTS - 1) / PARTS * np.sum((without - without.mean()) ** 2)))
    return float(products.sum() / squares.sum()), error
