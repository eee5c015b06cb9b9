"""Encoder errors without noise, quantisation and skew, and their inverse.

The measured angle is  angle + offset + sum_k amplitude_k sin(order_k angle + phase_k).
"""

from __future__ import annotations

from math import cos, isfinite, sin

import numpy as np
from numpy.typing import ArrayLike
from via_core.signals import Array

from via_sim.joint.compiled import bare, compiled, inlined
from via_sim.joint.parameters import P

_NEWTON_STEPS, _MAX_INVERSIONS = 3, 60  # least and largest number
_TOLERANCE = 1e-15  # relative to the measured angle


@inlined
def read_motion(p: Array, axis: int, angle: float, velocity: float) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] that the encoder of an axis measures, without noise and quantisation."""
    if p[P.encoder_harmonics + axis] == 0.0:
        return angle + p[P.encoder_offset + axis], velocity
    error, slope = encoder_error(p, axis, angle)
    return angle + error + p[P.encoder_offset + axis], velocity + slope * velocity


@bare
def encoder_error(p: Array, axis: int, angle: float) -> tuple[float, float]:
    """Periodic error [rad] of the encoder of an axis at an angle [rad], and its derivative by the angle [-]."""
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
    """True angle [rad] and velocity [rad/s] of an axis from the measured ones: inverse of `read_motion`.

    Newton's method with bisection bounds, because a Newton step on a sum of harmonics may overshoot.
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
        if step >= _NEWTON_STEPS and abs(excess) <= _TOLERANCE * (1.0 + abs(read)):
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
    """True angles (n,) [rad] of an axis from measured angles `read` (n,); parameter rows p (n, N_PARAMETERS)."""
    return true_motions(p, axis, read, np.zeros(np.shape(read)))[0]


def true_motions(p: Array, axis: int, read: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    """`true_motion` of measured angles [rad] and velocities [rad/s], (n,) each; p (n, N_PARAMETERS)."""
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
    """`true_motion` of angles and velocities, motion (2, n), in place; rows (n, N_PARAMETERS)."""
    for n in range(len(rows)):
        motion[0, n], motion[1, n] = true_motion(rows[n], axis, motion[0, n], motion[1, n])
