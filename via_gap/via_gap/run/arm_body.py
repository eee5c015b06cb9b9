"""Inertial numbers of a body that differ from those of an arm's model: a cause that all joints feel (arm_equation.py).

Y is the torque per mass, first and second moments of body k (pinocchio's regressor), phi their errors. Torques are
linear in them. A body of another density has all of them wrong by the same share: one unknown. Any other error, such
as a wrong centre of mass, has ten. Combinations that no torque shows (of a body behind a joint that does not move it,
for instance) remain as in the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from via_core.signals import Array

from via_gap.run.arm_equation import OneUnknown, explains
from via_gap.run.arm_model import Arm, with_numbers
from via_gap.run.arm_payload import REACH


@dataclass(frozen=True)
class BodyError:
    """What the model of a body lacks, in the frame of the joint that moves it.

    link     that joint
    tied     joints whose bodies could have the error as well, and other causes that explain as much
    numbers  (10,) mass [kg], first (3) [kg m] and second moments (6) [kg m^2] in pinocchio's order, with numbers_sd
    explained  largest share, over joints, of the held-out squared error that it removes
    share    error of all numbers over those of the model [-], with share_sd; None if their errors differ
    """

    link: str
    tied: tuple[str, ...]
    numbers: tuple[float, ...]
    numbers_sd: tuple[float, ...]
    explained: float
    share: float | None = None
    share_sd: float | None = None
    name: ClassVar[str] = "body"

    def text(self) -> str:
        """What differs, and how much of the missing torque it explains."""
        other = f" (or {', '.join(self.tied)})" if self.tied else ""
        return f"The body that {self.link} moves{other} is {self._error()}. {explains(self.explained)}"

    def _error(self) -> str:
        mass, *moment = (f"{a:z.3f} ± {b:.2g}" for a, b in zip(self.numbers[:4], self.numbers_sd[:4], strict=True))
        if self.share is None or self.share_sd is None:
            return (
                f"not that of the model: its mass differs by {mass} kg, mass times centre of mass by "
                f"({', '.join(moment)}) kg m in the frame of this joint"
            )
        kind = "heavier" if self.share > 0.0 else "lighter"
        return (
            f"{100.0 * abs(self.share):.3g} ± {100.0 * self.share_sd:.2g} % {kind} than in the model, with the same "
            f"centre of mass: its mass differs by {mass} kg"
        )


def with_body(arm: Arm, error: BodyError) -> Arm:
    """The arm with the body as the error says. Raises SignalError if the arm has no joint of its link."""
    return with_numbers(arm, error.link, np.array(error.numbers))


@dataclass(frozen=True)
class BodyNumbers:
    """Errors (10,) of the inertial numbers of a body: a `Shared` cause.

    column  number of the joint
    whole   [kg] mass of the arm; with REACH the standard deviation before anything is known
    """

    column: int
    whole: float

    def numbers(self, point: Array) -> Array:
        """The point itself."""
        return point

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """Least squares with a prior as wide as the arm."""
        width = self.whole * np.array([1.0, *3 * [REACH], *6 * [REACH**2]])
        inverse = np.linalg.inv(root[:, :-1].T @ root[:, :-1] + np.diag(width**-2.0))
        return inverse @ root[:, :-1].T @ root[:, -1], np.sqrt(np.diag(inverse))


class Density(OneUnknown):
    """The same error of all inertial numbers of a body, as a share of them."""
