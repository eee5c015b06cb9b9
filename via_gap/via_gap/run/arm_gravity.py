"""Gravity that differs from that of an arm's model, as a cause that all joints feel (arm_equation.py).

A base that is not mounted as the model says turns gravity in its frame; a recorded torque from which the controller has
subtracted gravity contains none. Torques are linear in gravity, so Y is the torque per gravity along each axis of the
base, and phi the missing gravity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.stats import chi2
from via_core.signals import Array

from via_gap.run.arm_equation import GRAVITY, NUMBERS_OF_BODY, explains
from via_gap.run.arm_model import Arm, under
from via_gap.selection.numbers import NUMBERS

WIDTH = 2.0 * 9.81  # [m/s^2] standard deviation of missing gravity before anything is known: it may be reversed


@dataclass(frozen=True)
class Gravity:
    """Gravity in the frame of the base.

    gravity  (3,) [m/s^2] in the torques, with gravity_sd
    modelled (3,) [m/s^2] in the model
    tied     other causes that explain as much, such as a payload
    explained  largest share, over joints, of the held-out squared error that it removes
    """

    gravity: tuple[float, float, float]
    gravity_sd: tuple[float, float, float]
    modelled: tuple[float, float, float]
    tied: tuple[str, ...]
    explained: float
    name: ClassVar[str] = "gravity"
    link: ClassVar[str] = "base"

    @property
    def tilt(self) -> float:
        """[rad] angle between both directions."""
        one, other = np.array(self.gravity), np.array(self.modelled)
        return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))

    @property
    def size(self) -> float:
        """Over the gravity of the model [-]."""
        return float(np.linalg.norm(self.gravity) / np.linalg.norm(self.modelled))

    @property
    def absent(self) -> bool:
        """Whether it is nearer to none than to that of the model."""
        return self.size < 0.5

    @property
    def tilted(self) -> bool:
        """Whether its direction has changed more than its size."""
        return not self.absent and 2.0 * np.sin(0.5 * self.tilt) > abs(self.size - 1.0)

    def text(self) -> str:
        """What differs, and how much of the missing torque it explains."""
        seen = ", ".join(f"{g:z.3f} ± {sd:.2g}" for g, sd in zip(self.gravity, self.gravity_sd, strict=True))
        stated = ", ".join(f"{each:z.3f}" for each in self.modelled)
        if self.absent:
            what = f"Gravity is absent from the recorded torques: they contain ({seen})"
            remedy = "The controller has subtracted it, or the model has wrong masses"
        elif not self.tilted:
            what = f"Gravity is {self.size:.3g} times that of the model: the torques contain ({seen})"
            remedy = "Check the masses of the model and the torque constants of all drives"
        else:
            what = f"Gravity points {np.degrees(self.tilt):.2f} degrees away from that of the model: it is ({seen})"
            remedy = "Check how the base is mounted"
        other = f" (or {', '.join(self.tied)})" if self.tied else ""
        return f"{what}, not ({stated}) m/s^2 in the frame of the base{other}. {remedy}. {explains(self.explained)}"


def with_gravity(arm: Arm, gravity: Gravity) -> Arm:
    """The arm under another gravity."""
    return under(arm, np.array(gravity.gravity))


@dataclass(frozen=True)
class MissingGravity:
    """Gravity (3,) [m/s^2] that the model lacks: a `Shared` cause."""

    column: int = GRAVITY

    def numbers(self, point: Array) -> Array:
        """The point, and zeros."""
        return np.append(point, np.zeros(NUMBERS_OF_BODY - 3))

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """Least squares with a prior of WIDTH; what the motion does not show remains as in the model."""
        inverse = np.linalg.inv(root[:, :3].T @ root[:, :3] + np.eye(3) / WIDTH**2)
        return inverse @ root[:, :3].T @ root[:, -1], np.sqrt(np.diag(inverse))


def significant(missing: Array, sd: Array) -> bool:
    """Whether missing gravity (3,) is not zero."""
    return float(np.sum((missing / sd) ** 2)) > chi2.ppf(1.0 - NUMBERS.significance, 3)
