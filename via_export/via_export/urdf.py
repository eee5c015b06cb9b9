"""URDF of a joint: a base, a link with its inertia, and a revolute joint with friction and limits.

Springs are rigid in URDF: inertia and friction of the motors are added to the link (the inertia as that of the body).
Source: URDF specification of ROS, elements link/inertial and joint/dynamics, joint/limit.
"""

from __future__ import annotations

from math import cos, isfinite, sin
from pathlib import Path

import numpy as np
from via_sim.joint.parameters import LINK, P

from via_export import payloads
from via_export.target import Target
from via_export.xml import Element, document, element

UNLIMITED = 1e9  # effort [N m] or velocity [rad/s] where none is known: URDF has no infinity
ROUNDED = 1e-4  # relative change of a weight or inertia that is not worth an edit by hand
WIDE = 1e3  # [rad] position limit on the side without a wall
WITH_GRAVITY = "0 -1 0"  # axis about which a link that hangs along -z turns
UPRIGHT = "0 0 1"


def write(target: Target, comment: str = "") -> str:
    """A robot of one joint. With gravity the axis is horizontal; at angle `gravity_angle` the link hangs along -z."""
    return document(robot(target), comment, declaration=True)


def robot(target: Target) -> Element:
    """The element `robot`: base, link and joint, as in `write`."""
    name = target.device.name
    return element(
        "robot", element("link", name=f"{name}_base"), element("link", _inertial(target), name=f"{name}_link"),
        joint(target, f"{name}_base", f"{name}_link"), name=name,
    )  # fmt: skip


def joint(target: Target, parent: str, child: str) -> Element:
    """The joint; an encoder offset turns its origin, so that the angle is that of the encoder."""
    offset = target.of_axis(P.encoder_offset, LINK)
    axis = UPRIGHT if target.gravity_torque == 0.0 else WITH_GRAVITY
    turn = [-offset * float(part) for part in axis.split()]
    made = element(
        "joint", element("origin", xyz="0 0 0", rpy=turn), element("parent", link=parent), element("child", link=child),
        element("axis", xyz=axis), name=target.names[0], type="revolute",
    )  # fmt: skip
    made.extend([*friction_and_limits(target)])
    return made


def friction_and_limits(target: Target) -> tuple[Element, Element]:
    """Elements `dynamics` and `limit`."""
    _, kinetic = target.rigid_dry
    low, high = target.ends
    offset = target.of_axis(P.encoder_offset, LINK)
    return (
        element("dynamics", damping=target.rigid_viscous, friction=kinetic),
        element("limit", lower=low + offset if isfinite(low) else -WIDE,
                upper=high + offset if isfinite(high) else WIDE,
                effort=target.effort if isfinite(target.effort) else UNLIMITED,
                velocity=target.speed if isfinite(target.speed) else UNLIMITED),
    )  # fmt: skip


def _inertial(target: Target) -> Element:
    """Mass, centre and inertia of the link; the motors add their inertia."""
    mass, distance, about = target.centre
    about += target.rigid_inertia - target.inertia
    hang = target.gravity_angle
    at = (-distance * sin(hang), 0.0, -distance * cos(hang)) if distance else (0.0, 0.0, 0.0)
    return element(
        "inertial", element("origin", xyz=at, rpy="0 0 0"), element("mass", value=mass),
        element("inertia", ixx=about, iyy=about, izz=about, ixy=0.0, ixz=0.0, iyz=0.0),
    )  # fmt: skip


def into(source: Element, target: Target, name: str, path: Path) -> list[str]:
    """Write friction, limits and changes of mass into a joint of the robot of file `path`, in place. Returns notes.

    Raises ValueError if there is no such joint.
    """
    found = next(
        (each for each in source.iter("joint") if each.get("name") == name and each.find("child") is not None), None
    )
    if found is None:
        names = ", ".join(str(each.get("name")) for each in source.iter("joint") if each.find("child") is not None)
        raise ValueError(f"no joint '{name}'; there are: {names or 'none'}")
    dynamics, limit = friction_and_limits(target)
    _replace(found, "dynamics", dynamics.attrib)
    given = found.find("limit")
    kept = {} if given is None else dict(given.attrib)
    known = {"effort": target.effort, "velocity": target.speed, "lower": target.ends[0], "upper": target.ends[1]}
    _replace(
        found,
        "limit",
        kept | {key: limit.attrib[key] for key, value in known.items() if isfinite(value) or key not in kept},
    )
    return _add_mass(source, found, target, path)


def _replace(parent: Element, tag: str, attributes: dict[str, str]) -> None:
    there = parent.find(tag)
    if there is None:
        there = element(tag)
        parent.append(there)
    there.attrib.clear()
    there.attrib.update(attributes)


def _add_mass(source: Element, joint: Element, target: Target, path: Path) -> list[str]:
    """Add payloads as links, and other changes of inertia to that of the joint's child, whose centre stays."""
    inertia_added, gravity_added = payloads.moments(target.effects)
    child = str(getattr(joint.find("child"), "attrib", {}).get("link"))
    link = next(each for each in source.iter("link") if each.get("name") == child)
    inertia = link.find("inertial/inertia")
    change = target.rigid_inertia - float(target.nominal[P.inertia + LINK]) - inertia_added
    notes = []
    if inertia is not None:
        for key in ("ixx", "iyy", "izz"):
            inertia.set(key, f"{float(inertia.get(key, '0')) + change:.10g}")
    elif abs(change) > ROUNDED * target.inertia:
        notes.append(f"link '{child}' has no inertia: {change:.6g} kg m^2 about the joint's axis were not added")
    if inertia_added:
        axis = str(getattr(joint.find("axis"), "attrib", {}).get("xyz", "1 0 0"))
        direction = payloads.hanging(path, str(joint.get("name")), np.array([float(each) for each in axis.split()]))
        for point in payloads.payloads_of(target.effects, str(joint.get("name")), direction):
            source.extend(point.urdf(child))
    weight = target.gravity_torque - abs(float(target.nominal[P.gravity_torque]))
    weight -= gravity_added * (float(target.nominal[P.gravity]) != 0.0)
    if abs(weight) > ROUNDED * max(target.gravity_torque, 1e-3):
        notes.append(f"change of the gravity torque by {weight:.6g} N m: move the centre of mass of link '{child}'")
    return notes
