"""URDF of a joint: a base, a link with its inertia, and a revolute joint with friction and limits.

Springs are rigid in URDF: inertia and friction of the motors are added to the link (the inertia as that of the body).
Source: URDF specification of ROS, elements link/inertial and joint/dynamics, joint/limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, isfinite, sin
from pathlib import Path

import numpy as np
import pinocchio
from via_core.signals import Array
from via_sim.joint.parameters import LINK, P

from via_export import notes, payloads
from via_export.target import Target
from via_export.xml import Element, child, document, element, joint_named, text

UNLIMITED = 1e9  # effort [N m] or velocity [rad/s] where none is known: URDF has no infinity
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
    found = joint_named(source, name, "child")
    offset = target.of_axis(P.encoder_offset, LINK)
    dynamics, limit = friction_and_limits(target)
    changed = _edit(found, dynamics, dynamics.attrib)
    if offset:
        shift_zero(found, offset)
        unit = "m" if _slides(found) else "rad"
        changed.append(f"origin and limits of the joint are shifted by the encoder offset of {offset:.6g} {unit}")
    known = {"effort": target.effort, "velocity": target.speed, "lower": target.ends[0], "upper": target.ends[1]}
    kept = () if found.find("limit") is None else child(found, "limit").attrib
    changed += _edit(found, limit, [key for key, value in known.items() if isfinite(value) or key not in kept])
    return changed + _add_mass(source, found, target, path)


def _slides(joint: Element) -> bool:
    return joint.get("type") == "prismatic"


def _edit(joint: Element, made: Element, keys: Iterable[str]) -> list[str]:
    """Set attributes of `dynamics` or `limit`, and keep others. A note on numbers that are replaced."""
    there = child(joint, made.tag)
    values = {key: (float(there.get(key, "0")), float(made.attrib[key])) for key in keys}
    there.attrib.update({key: made.attrib[key] for key in keys})
    return notes.replaced({f"{made.tag} {key}": pair for key, pair in values.items()})


def shift_zero(joint: Element, offset: float) -> None:
    """Add an offset [rad, m] to the joint's coordinate: turn or move its origin back; its limits move along."""
    axis = _axis(joint)
    origin = child(joint, "origin")
    turned = pinocchio.rpy.rpyToMatrix(vector(origin, "rpy"))
    if _slides(joint):
        origin.set("xyz", text(vector(origin, "xyz") - offset * turned @ axis))
    else:
        origin.set("rpy", text(pinocchio.rpy.matrixToRpy(turned @ pinocchio.exp3(-offset * axis))))
    limit = joint.find("limit")
    if limit is not None and joint.get("type") != "continuous":
        for key in ("lower", "upper"):
            limit.set(key, text(float(limit.get(key) or 0.0) + offset))


def _axis(joint: Element) -> Array:
    """Unit vector (3,) in the frame of the joint; x where none is stated."""
    given = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if given is None else vector(given, "xyz")
    return np.asarray(axis / np.linalg.norm(axis))


def vector(found: Element, key: str) -> Array:
    """Three numbers of an attribute; zeros without it."""
    return np.array([float(each) for each in (found.get(key) or "0 0 0").split()])


def _add_mass(source: Element, joint: Element, target: Target, path: Path) -> list[str]:
    """Add payloads as links, and other changes of inertia to that of the joint's child, whose centre stays.

    What moves on a slide is a mass.
    """
    below = str(child(joint, "child").get("link"))
    link = next(each for each in source.iter("link") if each.get("name") == below)
    change = notes.inertia_added(target, target.rigid_inertia)
    found = notes.sliding_payload(target) if _slides(joint) else []
    if _slides(joint):
        change += payloads.moments(target.effects)[0]
        entries = [(link.find("inertial/mass"), "value")]
    else:
        entries = [(link.find("inertial/inertia"), key) for key in ("ixx", "iyy", "izz")]
        if payloads.moments(target.effects)[0]:
            direction = payloads.hanging(path, str(joint.get("name")), _axis(joint))
            for point in payloads.payloads_of(target.effects, str(joint.get("name")), direction):
                source.extend(point.urdf(below))
    if abs(change) > notes.SMALL * target.inertia:
        for entry, key in entries:
            if entry is None:
                unit = "kg" if _slides(joint) else "kg m^2 about the joint's axis"
                found.append(f"link '{below}' has no inertial: {change:.6g} {unit} were not added")
                break
            entry.set(key, f"{float(entry.get(key, '0')) + change:.10g}")
    return found + notes.weight(target, f"link '{below}'")
