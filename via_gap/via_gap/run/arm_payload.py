"""A mass that the bodies of an arm lack, such as a payload, as a cause that all joints feel (arm_equation.py).

Y_k is the torque per mass, first and second moments of body k (pinocchio's regressor), and phi those of a point mass m
at p in the frame of joint k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares
from via_core.signals import Array

from via_gap.run.arm_equation import explains
from via_gap.run.arm_model import Arm, with_numbers

REACH = 1.0  # [m] standard deviation of the position before anything is known: the size of an arm
_LINE = np.linspace(-REACH, REACH, 11)
GRID = np.stack(np.meshgrid(_LINE, _LINE, _LINE), axis=-1).reshape(-1, 3)  # [m] positions where fits may start
STARTS = 5  # of these, the best ones


@dataclass(frozen=True)
class Payload:
    """A point mass in the frame of a joint.

    link          joint that moves it
    tied          joints that could move it as well: their held-out errors are not significantly larger
    mass          [kg] with mass_sd; negative: the bodies are too heavy
    position      (3,) [m] in the joint's frame with position_sd
    explained     largest share, over joints, of the held-out squared error that it removes
    """

    link: str
    tied: tuple[str, ...]
    mass: float
    mass_sd: float
    position: tuple[float, float, float]
    position_sd: tuple[float, float, float]
    explained: float
    name: ClassVar[str] = "payload"

    @property
    def moments(self) -> Array:
        """Mass, first and second moments (10,) in pinocchio's order."""
        return _point_mass(np.array([self.mass, *self.position]))

    def text(self) -> str:
        """What differs, and how much of the missing torque it explains."""
        place = ", ".join(f"{a:z.3f} ± {b:.2g}" for a, b in zip(self.position, self.position_sd, strict=True))
        other = f" (or {', '.join(self.tied)})" if self.tied else ""
        what = "Payload" if self.mass > 0.0 else "Mass that is absent"
        return (
            f"{what} at {self.link}{other}: mass {abs(self.mass):.3g} ± {self.mass_sd:.2g} kg at ({place}) m in the "
            f"frame of this joint. {explains(self.explained)}"
        )


def with_payload(arm: Arm, payload: Payload) -> Arm:
    """The arm whose bodies contain the payload. Raises SignalError if the arm has no joint of its link."""
    return with_numbers(arm, payload.link, payload.moments)


@dataclass(frozen=True)
class PointMass:
    """A point mass (mass, position in the frame of the joint) at the body that a joint moves: a `Shared` cause.

    column  number of the joint
    there   [kg] mass of the body itself, which is all that can be absent
    sd      [kg] standard deviation of the mass before anything is known: the mass of the arm
    """

    column: int
    there: float
    sd: float

    def numbers(self, point: Array) -> Array:
        """Mass, first and second moments (10,) of the point (4,) [kg, m]."""
        return _point_mass(point)

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """The point with least error, and its standard deviations; without `start` from STARTS of GRID."""
        starts = [start] if start is not None and np.any(start) else self._starts(root)
        least = [-self.there, *3 * [-np.inf]]
        fits = [
            least_squares(self._error, each, args=(root,), bounds=(least, np.inf), x_scale=[1.0, 0.1, 0.1, 0.1])
            for each in starts
        ]
        found = min(fits, key=lambda fit: float(fit.cost))
        return found.x, np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)))

    def _starts(self, root: Array) -> list[Array]:
        """The STARTS positions of GRID with the least error, each with its best mass: the error has several minima."""
        columns = root[:, :-1] @ np.array([_point_mass(np.array([1.0, *place])) for place in GRID]).T
        weight = np.sum(columns**2, axis=0) + self.sd**-2
        best = np.maximum(columns.T @ root[:, -1] / weight, -self.there)
        error = np.sum((columns * best - root[:, -1:]) ** 2, axis=0) + (best / self.sd) ** 2
        error += np.sum(GRID**2, axis=1) / REACH**2
        return [np.array([best[i], *GRID[i]]) for i in np.argsort(error)[:STARTS]]

    def _error(self, point: Array, root: Array) -> Array:
        """Whitened error of a point mass, and its distance from none at the joint."""
        return np.concatenate([root @ np.append(_point_mass(point), -1.0), [point[0] / self.sd], point[1:] / REACH])


def _point_mass(point: Array) -> Array:
    """Mass, first and second moments (10,) of a mass at a position, (4,) [kg, m], in pinocchio's order."""
    m, x, y, z = point
    return m * np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
