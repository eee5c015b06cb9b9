"""Where a mechanical stop may hold a motor.

A motor does not pass its stop, so it can touch one only at the largest or smallest angle that it has ever reached.
There the stop carries any torque outward, and none inward.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from via_core.signals import Array

SPAN = 0.1  # [s] of a modulated row
UNREACHED = float(np.finfo(np.float64).max)  # [rad] extremes before any sample: numbers of a state are finite
PRESLIDING = 2e-3  # [rad] of travel, within which dry friction has not built up and may point anywhere


def reach_of(time: Array, theta: Array) -> Array:
    """Smallest and largest mean (2, m) over SPAN of motor angles (N, m) [rad]; a bounce at a stop is shorter."""
    count = theta.shape[1]
    found = np.array([np.full(count, np.inf), np.full(count, -np.inf)])
    lasted = float(time[-1] - time[0]) if len(time) else 0.0
    n = max(round(SPAN * (len(time) - 1) / lasted), 1) if lasted > 0.0 else 0
    if 0 < n <= len(time):
        for i in range(count):
            mean = np.convolve(theta[:, i], np.full(n, 1.0 / n), "valid")
            mean = mean[np.isfinite(mean)]
            found[:, i] = (mean.min(), mean.max()) if len(mean) else found[:, i]
    return found


def stopped_text(motor: int, angle: float, upper: bool) -> str:
    """The diagnostic of a motor, from 1, that pushes against something at `angle` [rad]."""
    return (
        f"motor {motor} rests at {angle:.2f} rad, the {'largest' if upper else 'smallest'} angle that it has reached, "
        f"and pushes outward: a mechanical stop or another obstacle holds it, or theta_{motor} is frozen; move it away"
    )


@njit(cache=True, error_model="numpy")
def touched(time: Array, angle: Array, lowest: float, highest: float) -> Array:
    """1 or -1 (N,) where a motor rests for SPAN, or until the end, at the largest or smallest angle reached, else 0."""
    found, first = np.zeros(time.size), 0
    if highest - lowest <= 2.0 * PRESLIDING:  # nothing distinguishes a stop from a motor that rests
        return found
    for k in range(time.size):
        side = 1.0 if angle[k] > highest - PRESLIDING else -1.0 if angle[k] < lowest + PRESLIDING else 0.0
        if side == 0.0:
            first = k + 1
        elif time[k] - time[first] >= SPAN or k == time.size - 1:
            found[first : k + 1] = side
    return found
