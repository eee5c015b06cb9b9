"""A joint whose angle is counted from another zero than in an arm's model: a cause that all joints feel.

A wrong zero of joint k, by delta, changes the torque that the measured angles require of every joint (arm_equation.py):
Y is the derivative of these torques by q_k with opposite sign, phi is delta.

Source: J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, Robotics: Science and
Systems 2018.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from via_core.signals import Array

from via_gap.run.arm_equation import NUMBERS_OF_BODY, ArmFit, OneUnknown, explains, offset_column
from via_gap.run.arm_model import Arm, joint_number

LINEAR = 0.2  # [rad] largest offset: beyond it the derivative is wrong by more than 2 %, and a body may resemble it


@dataclass(frozen=True)
class AngleOffset:
    """A wrong zero of a joint's angle.

    link       the joint
    tied       other causes that explain as much
    offset     [rad] of the measured angle: measured minus true, with offset_sd
    explained  largest share, over joints, of the held-out squared error that it removes
    """

    link: str
    tied: tuple[str, ...]
    offset: float
    offset_sd: float
    explained: float
    name: ClassVar[str] = "offset"

    def text(self) -> str:
        """What differs, and how much of the missing torque it explains."""
        other = f" (or {', '.join(self.tied)})" if self.tied else ""
        size = f"{np.degrees(abs(self.offset)):.3g} ± {np.degrees(self.offset_sd):.2g} degrees"
        return (
            f"The angle of {self.link}{other} is {size} ({abs(self.offset):.4f} rad) too "
            f"{'large' if self.offset > 0.0 else 'small'} for the model: check the zero of its encoder. "
            f"{explains(self.explained)}"
        )


class Zero(OneUnknown):
    """The offset [rad] of a joint's angle."""

    @staticmethod
    def of(arm: Arm, joint: int) -> Zero:
        """That of the joint with this number."""
        column, slot = offset_column(len(arm.devices), joint)
        return Zero(column, joint, tuple(np.eye(NUMBERS_OF_BODY)[slot]), (-LINEAR, LINEAR))


@dataclass(frozen=True)
class Zeros:
    """Offsets (n,) [rad] of the angles of all joints: a `Shared` cause. At most as many as fit into one column."""

    column: int
    joints: int

    @staticmethod
    def of(arm: Arm) -> Zeros:
        """Those of the first joints."""
        return Zeros(offset_column(len(arm.devices), 0)[0], min(len(arm.devices), NUMBERS_OF_BODY))

    def numbers(self, point: Array) -> Array:
        """The offsets, and zeros."""
        return np.append(point, np.zeros(NUMBERS_OF_BODY - self.joints))

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """Least squares with a prior of LINEAR."""
        columns = root[:, : self.joints]
        inverse = np.linalg.inv(columns.T @ columns + np.eye(self.joints) / LINEAR**2)
        return np.clip(inverse @ columns.T @ root[:, -1], -LINEAR, LINEAR), np.sqrt(np.diag(inverse))

    def clearest(self, arm: Arm, fit: ArmFit, sd: Array) -> tuple[ArmFit, Array]:
        """The fit with only the offset that is largest in standard deviations (n,), and its own (1,)."""
        joint = int(np.argmax(np.abs(fit.point) / sd))
        return replace(fit, cause=Zero.of(arm, joint), point=fit.point[[joint]]), sd[[joint]]


def with_offset(arm: Arm, error: AngleOffset) -> Arm:
    """The arm that counts the angle from its true zero. Raises SignalError if the arm has no joint of that name."""
    reference = np.zeros(len(arm.devices)) if arm.reference is None else arm.reference.copy()
    reference[joint_number(arm, error.link)] += error.offset
    return replace(arm, reference=reference)
