"""Estimates of joint velocities from angles: their derivative behind a first-order low pass."""

from __future__ import annotations

from math import exp

from numba import njit
from via_core.signals import Array

LARGEST = 1e6  # [rad] larger angles are transmission errors, which would corrupt the velocity


@njit(cache=True, error_model="numpy")
def low_passed(velocity: Array, before: Array, now: Array, step: float, bandwidth: float) -> Array:
    """Velocities [rad/s] `step` [s] after `velocity`, while the angles [rad] went from `before` to `now`.

    All arrays have one shape, whatever it is.
    bandwidth  [rad/s]; a step <= 0 returns a copy of `velocity`
    """
    if step > 0.0:
        return velocity + (1.0 - exp(-bandwidth * step)) * ((now - before) / step - velocity)
    return velocity.copy()
