"""What an encoder reads of an angle, but for noise, steps and lateness; and the angle from the reading.

It reads  angle + offset + sum_k amplitude_k sin(order_k angle + phase_k).
"""

from __future__ import annotations

from math import cos, isfinite, sin

import numpy as np
from numpy.typing import ArrayLike
from via_core.signals import Array

from via_sim.compiled import bare, compiled, inlined
from via_sim.parameters import P

_NEWTON_STEPS, _MAX_INVERSIONS = 3, 60  # to undo an encoder's error: at least and at most
_INVERTED = 1e-15  # of the reading: how exactly


@inlined
def read_motion(p: Array, axis: int, angle: float, velocity: float) -> tuple[float, float]:
    """What the encoder of an axis reads, and the speed of that reading, but for noise and steps [rad, rad/s]."""
    if p[P.encoder_harmonics + axis] == 0.0:
        return angle + p[P.encoder_offset + axis], velocity
    error, slope = encoder_error(p, axis, angle)
    return angle + error + p[P.encoder_offset + axis], velocity + slope * velocity


@bare
def encoder_error(p: Array, axis: int, angle: float) -> tuple[float, float]:
    """Periodic error [rad] of the encoder of an axis at an angle [rad], and its slope over the angle [-]."""
    error = slope = 0.0
    for k in range(axis, 3 * int(p[P.encoder_harmonics + axis]), 3):
        swing, order = p[P.eccentricity + k], p[P.eccentricity_order + k]
        if swing != 0.0:
            turned = order * angle + p[P.eccentricity_phase + k]
            error += swing * sin(turned)
            slope += order * (swing * cos(turned))
    return error, slope


@bare
def true_motion(p: Array, axis: int, read: float, velocity: float) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] of an axis whose encoder reads these: `read_motion` undone.

    Newton's method, kept between bounds that close in on the root: of a sum of harmonics a step may overshoot.
    """
    read -= p[P.encoder_offset + axis]
    harmonics = int(p[P.encoder_harmonics + axis])
    if harmonics == 0 or not isfinite(read):
        return read, velocity
    reach = 0.0
    for k in range(axis, 3 * harmonics, 3):
        reach += abs(p[P.eccentricity + k])
    low, high = read - reach, read + reach
    angle = read - encoder_error(p, axis, read)[0]
    for step in range(_MAX_INVERSIONS):
        error, slope = encoder_error(p, axis, angle)
        excess = angle + error - read
        if step >= _NEWTON_STEPS and abs(excess) <= _INVERTED * (1.0 + abs(read)):
            break
        if excess > 0.0:
            high = angle
        else:
            low = angle
        angle -= excess / (1.0 + slope)
        if not low <= angle <= high:
            angle = 0.5 * (low + high)
    return angle, velocity / (1.0 + encoder_error(p, axis, angle)[1])


def true_angle(p: Array, axis: int, read: ArrayLike) -> Array:
    """Angle [rad] (n,) at which the encoder of an axis reads `read` (n,): `read_motion` undone; p (n, N_PARAMETERS)."""
    return true_motions(p, axis, read, np.zeros(np.shape(read)))[0]


def true_motions(p: Array, axis: int, read: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    """`true_motion` of many: angles [rad] and velocities [rad/s] as read, (n,) each; p (n, N_PARAMETERS)."""
    shape, width = np.broadcast_shapes(np.shape(p)[:-1], np.shape(read)), np.shape(p)[-1]
    angle = np.broadcast_to(np.asarray(read, dtype=np.float64) - p[..., P.encoder_offset + axis], shape)
    if not np.any(p[..., P.encoder_harmonics + axis]):
        return angle, np.broadcast_to(np.asarray(velocity, dtype=np.float64), shape)
    rows = np.array(np.broadcast_to(p, (*shape, width))).reshape(-1, width)
    motion = np.stack([np.broadcast_to(each, shape).ravel() for each in (read, velocity)]).astype(np.float64)
    _undo(rows, axis, motion)
    return motion[0].reshape(shape), motion[1].reshape(shape)


@compiled
def _undo(rows: Array, axis: int, motion: Array) -> None:
    """`true_motion` of each row (n, N_PARAMETERS) -> motion (2, n), angles and velocities, in place."""
    for n in range(len(rows)):
        motion[0, n], motion[1, n] = true_motion(rows[n], axis, motion[0, n], motion[1, n])
