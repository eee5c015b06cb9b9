"""What an end effector meets: walls that it hits, hands that hold it.

Wall, half-space behind a plane, delta = -normal . (p - point) how deep the tip is in it:

    F = max(0, K delta + D deltad) normal   where delta > 0,   else 0

so that a wall pushes and never pulls, without friction. A force begins at D deltad, which is what a damper in parallel
means; energy is lost at every impact by it.

Hand, a spring and a damper to one point:  F = -K (p - point) - D pd
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array, locked


class Contact(ABC):
    """Something that acts on the tip of an arm."""

    @abstractmethod
    def touches(self, position: Array) -> bool:
        """Whether it may act on a tip at `position` (3,) [m]."""

    @abstractmethod
    def force(self, position: Array, velocity: Array) -> Array:
        """On the tip (3,) [N], which is at `position` (3,) [m] and moves at `velocity` (3,) [m/s]."""


@dataclass(frozen=True, eq=False)
class Wall(Contact):
    """A plane that nothing passes. Raises ParameterError for a normal without a direction."""

    point: Array  # (3,) [m] on the plane
    normal: Array  # (3,) [-] out of the wall, of any length; kept as a unit vector
    stiffness: float = 5e4  # K [N/m]
    damping: float = 300.0  # D [N s/m]

    def __post_init__(self) -> None:
        _checked(self)
        normal = locked(self.normal, "normal")
        length = float(np.linalg.norm(normal))
        if normal.shape != (3,) or not 0.0 < length < np.inf:
            raise ParameterError(f"normal must be a direction (3 numbers, not all 0), got {self.normal}")
        object.__setattr__(self, "normal", locked(normal / length, "normal"))

    def depth(self, position: Array) -> float:
        """How deep `position` (3,) [m] is in the wall [m]; negative outside of it."""
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
        _checked(self)

    def touches(self, position: Array) -> bool:
        return True

    def force(self, position: Array, velocity: Array) -> Array:
        return self.stiffness * (self.point - position) - self.damping * velocity


def _checked(contact: Wall | Hand) -> None:
    object.__setattr__(contact, "point", locked(contact.point, "point"))
    if contact.point.shape != (3,) or not np.isfinite(contact.point).all():
        raise ParameterError(f"point must be (3,) and finite, got {contact.point}")
    for name in ("stiffness", "damping"):
        value = getattr(contact, name)
        if not (np.isfinite(value) and value >= 0.0):
            raise ParameterError(f"{name} must be >= 0, got {value}")
