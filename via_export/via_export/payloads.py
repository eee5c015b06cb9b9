"""Point masses as bodies of a given robot: payloads of a joint's effects, or of a whole arm (arm_causes.py).

MJCF  body with an inertial, in the body that the joint moves
URDF  link with an inertial, and a fixed joint to the child link
SDF   the same, posed relative to the child link
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio
from via_core.robots.models import read_robot
from via_core.signals import Array
from via_sim.effects import Effect
from via_sim.plants import GRAVITY

from via_export.xml import Element, element, leaf

SMALL = 1e-9  # [m] distance of a centre of mass from an axis that counts as none
SPHERE = 1e-9  # [m^2] inertia per mass: MuJoCo and URDF parsers accept no point


@dataclass(frozen=True)
class PointMass:
    """A mass [kg] at `position` (3,) [m] in the frame of the joint that moves it."""

    name: str
    mass: float
    position: Sequence[float]

    def body(self, anchor: Array) -> Element:
        """Body of MJCF; the joint's frame lies at `anchor` in that of its body."""
        inertial = element("inertial", pos=(0.0, 0.0, 0.0), mass=self.mass, diaginertia=(SPHERE * self.mass,) * 3)
        return element("body", inertial, name=self.name, pos=anchor + np.asarray(self.position))

    def urdf(self, link: str) -> tuple[Element, Element]:
        """Link and fixed joint; the frame of a joint is that of its child `link`."""
        about = SPHERE * self.mass
        inertia = element("inertia", ixx=about, ixy=0.0, ixz=0.0, iyy=about, iyz=0.0, izz=about)
        inertial = element("inertial", element("mass", value=self.mass), inertia)
        joint = element(
            "joint", element("parent", link=link), element("child", link=self.name),
            element("origin", xyz=self.position, rpy="0 0 0"), name=f"{self.name}_fixed", type="fixed",
        )  # fmt: skip
        return element("link", inertial, name=self.name), joint

    def sdf(self, link: str) -> tuple[Element, Element]:
        """Link and fixed joint."""
        about = SPHERE * self.mass
        parts = [leaf(key, about if key[1] == key[2] else 0.0) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        pose = leaf("pose", (*self.position, 0.0, 0.0, 0.0))
        pose.set("relative_to", link)
        body = element(
            "link", pose, element("inertial", leaf("mass", self.mass), element("inertia", *parts)), name=self.name
        )
        joint = element(
            "joint", leaf("parent", link), leaf("child", self.name), name=f"{self.name}_fixed", type="fixed"
        )
        return body, joint


def payloads_of(effects: Sequence[Effect], joint: str, direction: Array) -> list[PointMass]:
    """Payloads among the effects of a joint, in the `direction` (3,) of the weight that it already moves."""
    found = [effect.parameters for effect in effects if effect.name == "payload"]
    return [
        PointMass(f"{joint}_payload_{k}", each["mass"], tuple(each["distance"] * direction))
        for k, each in enumerate(found, 1)
    ]


def moments(effects: Sequence[Effect]) -> tuple[float, float]:
    """Inertia [kg m^2] and largest gravity torque [N m] of all payloads."""
    found = [effect.parameters for effect in effects if effect.name == "payload"]
    inertia = sum(each["mass"] * each["distance"] ** 2 for each in found)
    return inertia, GRAVITY * sum(each["mass"] * each["distance"] for each in found)


def across(centre: Array, axis: Array) -> Array:
    """Unit vector (3,) from an axis to a centre of mass; any one across the axis if the centre lies on it."""
    axis = axis / np.linalg.norm(axis)
    apart = centre - axis * (axis @ centre)
    if np.linalg.norm(apart) < SMALL:
        apart = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    return np.asarray(apart / np.linalg.norm(apart))


def hanging(path: Path, joint: str, axis: Array) -> Array:
    """Direction (3,) of the weight that a joint of a URDF moves, in its frame, with all joints at zero."""
    model = read_robot(path).model
    data = model.createData()
    pinocchio.centerOfMass(model, data, pinocchio.neutral(model), True)
    return across(data.com[model.getJointId(joint)], axis)
