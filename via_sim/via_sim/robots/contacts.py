"""Contacts of an end effector: walls and hands.

A wall is a half-space behind a plane, with penetration depth delta = -normal . (p - point):

    F = max(0, K delta + D deltad) normal   where delta > 0,   else 0

It pushes and never pulls, without friction. Because spring and damper are in parallel, the force begins at D deltad;
the damper dissipates energy at each impact.

A hand is a spring and a damper to one point:  F = -K (p - point) - D pd
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array, locked


class Contact(ABC):
    """A force on the tip of an arm."""

    @abstractmethod
    def touches(self, position: Array) -> bool:
        """Whether the force can be nonzero at tip `position` (3,) [m]."""

    @abstractmethod
    def force(self, position: Array, velocity: Array) -> Array:
        """Force (3,) [N] on a tip at `position` (3,) [m] with `velocity` (3,) [m/s]."""


@dataclass(frozen=True, eq=False)
class Wall(Contact):
    """A wall behind a plane. Raises ParameterError for a normal of zero length."""

    point: Array  # (3,) [m] on the plane
    normal: Array  # (3,) [-] outwards, of any length; stored as a unit vector
    stiffness: float = 5e4  # K [N/m]
    damping: float = 300.0  # D [N s/m]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _checked_point(self.point, self.stiffness, self.damping))
        normal = locked(self.normal, "normal")
        length = float(np.linalg.norm(normal))
        if normal.shape != (3,) or not 0.0 < length < np.inf:
            raise ParameterError(f"normal must be a direction (3 numbers, not all 0), got {self.normal}")
        object.__setattr__(self, "normal", locked(normal / length, "normal"))

    def depth(self, position: Array) -> float:
        """Penetration depth [m] of `position` (3,) [m]; negative outside the wall."""
        return float(self.normal @ (self.point - position))

    def touches(self, position: Array) -> bool:
        return self.depth(position) > 0.0

    def force(self, position: Array, velocity: Array) -> Array:
        depth = self.depth(position)
        if depth <= 0.0:
            return np.zeros(3)
        return max(0.0, self.stiffness * depth - self.damping * float(self.normal @ velocity)) * self.normal


@dataclass(frozen=True, eq=False)
class Hand(Contact):
    """A grip that holds the tip at a point."""

    point: Array  # (3,) [m]
    stiffness: float = 5e3  # K [N/m]
    damping: float = 100.0  # D [N s/m]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _checked_point(self.point, self.stiffness, self.damping))

    def touches(self, position: Array) -> bool:
        return True

    def force(self, position: Array, velocity: Array) -> Array:
        return self.stiffness * (self.point - position) - self.damping * velocity


def _checked_point(point: Array, stiffness: float, damping: float) -> Array:
    """The point (3,), locked; raises ParameterError for invalid parameters of a contact."""
    point = locked(point, "point")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ParameterError(f"point must be (3,) and finite, got {point}")
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        if not (np.isfinite(value) and value >= 0.0):
            raise ParameterError(f"{name} must be >= 0, got {value}")
    return point
