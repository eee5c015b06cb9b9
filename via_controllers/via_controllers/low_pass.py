"""Estimates of joint velocities from angles: their derivative behind a first-order low pass."""

from __future__ import annotations

from math import exp

from via_core.signals import Array


def low_passed(velocity: Array, before: Array, now: Array, step: float, bandwidth: float) -> Array:
    """Velocities (n,) [rad/s] `step` [s] after `velocity`, while the angles (n,) [rad] went from `before` to `now`.

    bandwidth  [rad/s]; a step <= 0 returns `velocity`
    """
    if step <= 0.0:
        return velocity
    return velocity + (1.0 - exp(-bandwidth * step)) * ((now - before) / step - velocity)
