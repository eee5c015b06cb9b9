"""Coordinates in which masses at a distance act linearly: m l and m l^2 in place of mass m and distance l.

If a log determines neither m nor l alone, the loss has a curved valley in (m, l). A straight step leaves the valley.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array


def straightened(values: Array, levers: Sequence[int]) -> Array:
    """(p,) parameters with m l and m l^2 in place of m and l."""
    out = values.copy()
    for i in levers:
        out[i], out[i + 1] = values[i] * values[i + 1], values[i] * values[i + 1] ** 2
    return out


def bent(straight: Array, levers: Sequence[int]) -> Array:
    """(p,) parameters from those of `straightened`; no mass without weight."""
    out = straight.copy()
    for i in levers:
        weight, turning = straight[i], straight[i + 1]
        out[i], out[i + 1] = (weight**2 / turning, turning / weight) if min(weight, turning) > 0.0 else (0.0, 0.0)
    return out


def bending(straight: Array, levers: Sequence[int]) -> Array:
    """(p, p) derivatives of `bent`."""
    slopes = np.eye(len(straight))
    for i in levers:
        weight, turning = straight[i], straight[i + 1]
        if min(weight, turning) > 0.0:
            of_mass, of_distance = [2.0 * weight, -(weight**2) / turning], [-turning / weight**2, 1.0 / weight]
            slopes[i, i : i + 2], slopes[i + 1, i : i + 2] = np.divide(of_mass, turning), of_distance
    return slopes
