"""URDF files, read by pinocchio, with everything that they state about each joint."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio

from via_core.errors import DeviceError, ParameterError, one_line
from via_core.robots.models import Robot, RobotJoint

MOVING = ("revolute", "continuous", "prismatic")


def read_urdf(path: Path, text: str, root: ElementTree.Element) -> Robot:
    """The robot of a URDF file with the XML tree `root`. Raises DeviceError in one line with the remedy."""
    if root.find(".//{http://www.ros.org/wiki/xacro}*") is not None or "<xacro:" in text:
        raise DeviceError(f"{path}: contains xacro macros; write the URDF with `xacro {path} > plain.urdf`")
    elements = {str(each.get("name")): each for each in root.findall("joint")}
    children = {_link(each, "child"): each for each in elements.values()}
    try:
        _check_tree(root, children)
        for link in root.findall("link"):
            _check_inertial(link)
        model, warnings = _built(_bodies_only(root))
        joints = [_joint(elements[name], root) for name in model.names if name in elements and _moves(elements[name])]
        followed = _with_followers(joints)
    except ParameterError as error:
        raise DeviceError(f"{path}: {error}") from None
    rotors = np.zeros(model.nv)
    for each in joints:
        rotors[model.joints[model.getJointId(each.name)].idx_v] = each.armature or 0.0
    model.armature = rotors
    odd = [str(e.get("name")) for e in elements.values() if e.get("type") in ("floating", "planar")]
    remarks = [*warnings, *([f"joints {', '.join(odd)} float or slide in a plane: taken as fixed"] if odd else [])]
    light = [str(link.get("name")) for link in root.findall("link") if link.find("inertial") is None]
    bare = [name for name in light if name in children and _moves(children[name])]
    if bare:
        remarks.append(f"links {', '.join(bare)} state no <inertial>: taken as massless")
    return Robot(str(root.get("name") or path.stem), str(path), model, followed, tuple(remarks))


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _check_tree(root: ElementTree.Element, children: Mapping[str, ElementTree.Element]) -> None:
    """Raise ParameterError where the links are no tree."""
    for link in root.findall("link"):
        at = str(link.get("name"))
        passed: list[str] = []
        while at in children:
            if at in passed:
                raise ParameterError(
                    f"links {', '.join(reversed(passed))} form a cycle; a URDF is a tree: remove a joint"
                )
            passed.append(at)
            at = _link(children[at], "parent")


def _check_inertial(link: ElementTree.Element) -> None:
    """Raise ParameterError for negative or infinite masses and moments of inertia."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    number, where = _Numbers(inertial), f"link '{link.get('name')}': <inertial>"
    try:
        mass = number("mass", "value")
        moments = [number("inertia", key) for key in ("ixx", "iyy", "izz")]
        _ = [number("inertia", key) for key in ("ixy", "ixz", "iyz")]
    except ParameterError as error:
        raise ParameterError(f"{where} states {error}") from None
    for name, value in zip(("mass", "ixx", "iyy", "izz"), (mass, *moments), strict=True):
        if value is not None and value < 0.0:
            raise ParameterError(f"{where} states {name} {value:g}; it must be 0 or more")


def _built(text: str) -> tuple[pinocchio.Model, list[str]]:
    """The bodies, and warnings of the parser. Raises ParameterError with the parser's reason.

    The parser writes its reasons to standard error, in several lines each, and leaves out what it cannot read.
    """
    problem, model = "", None
    with _standard_error() as lines:
        try:
            model = pinocchio.buildModelFromXML(text)
        except (ValueError, RuntimeError, IndexError) as error:
            problem = one_line(error)
    found = re.findall(r"^(Error|Warning):\s*(.*)$", "\n".join(lines), re.MULTILINE)
    errors = [reason for sort, reason in found if sort == "Error"]
    if model is None or errors:
        raise ParameterError(f"not a valid URDF: {(errors or [problem])[0][:160]}")
    return model, [reason for sort, reason in found if sort == "Warning"]


@contextmanager
def _standard_error() -> Iterator[list[str]]:
    """The lines that compiled code writes to standard error meanwhile, afterwards in the list."""
    lines: list[str] = []
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with os.fdopen(os.memfd_create("stderr"), "w+b") as file:
            os.dup2(file.fileno(), 2)
            try:
                yield lines
            finally:
                os.dup2(kept, 2)
                file.seek(0)
                lines += file.read().decode(errors="replace").splitlines()
    finally:
        os.close(kept)


def _with_followers(joints: Sequence[RobotJoint]) -> tuple[RobotJoint, ...]:
    """Joints whose friction and rotor include those of the joints that follow them."""
    by_name = {each.name: each for each in joints}
    rooted = {each.name: _rooted(each, by_name) for each in joints}
    made = []
    for joint in rooted.values():
        following = [each for each in rooted.values() if each.mimic == joint.name]
        remarks = [
            f"{each.name} follows it by a factor {each.multiplier:g}: its inertia, friction and gravity are included"
            for each in following
        ]
        if joint.mimic:
            remarks.append(
                f"follows joint {joint.mimic} by a factor {joint.multiplier:g}: describe {joint.mimic}, which includes "
                "the numbers of this joint"
                if joint.mimic in rooted
                else f"follows joint {joint.mimic}, which does not move: taken as free"
            )
        made.append(
            replace(
                joint,
                damping=_sum(joint.damping, [(e.multiplier**2, e.damping) for e in following]),
                friction=_sum(joint.friction, [(abs(e.multiplier), e.friction) for e in following]),
                armature=_sum(joint.armature, [(e.multiplier**2, e.armature) for e in following]),
                remarks=(*remarks, *joint.remarks),
            )
        )
    return tuple(made)


def _rooted(joint: RobotJoint, by_name: Mapping[str, RobotJoint]) -> RobotJoint:
    """The joint as a follower of the first joint of a chain."""
    passed = {joint.name}
    while joint.mimic in by_name and by_name[joint.mimic].mimic and joint.mimic not in passed:
        master = by_name[joint.mimic]
        passed.add(joint.mimic)
        joint = replace(
            joint,
            mimic=master.mimic,
            multiplier=joint.multiplier * master.multiplier,
            offset=joint.multiplier * master.offset + joint.offset,
        )
    if joint.mimic in passed:
        raise ParameterError(f"joints {', '.join(sorted(passed))} mimic each other; one of them must move freely")
    return joint


def _sum(own: float | None, others: Sequence[tuple[float, float | None]]) -> float | None:
    stated = [weight * value for weight, value in ((1.0, own), *others) if value is not None]
    return sum(stated) if stated else None


def _bodies_only(root: ElementTree.Element) -> str:
    """The URDF without what the bodies do not need, so that missing meshes and numbers read here cannot matter."""
    copied = ElementTree.fromstring(ElementTree.tostring(root))
    for link in copied.findall("link"):
        for tag in ("visual", "collision"):
            for each in link.findall(tag):
                link.remove(each)
    for joint in copied.findall("joint"):
        for each in joint.findall("dynamics"):
            joint.remove(each)
    for tag in ("gazebo", "transmission", "ros2_control", "material"):
        for each in copied.findall(tag):
            copied.remove(each)
    return ElementTree.tostring(copied, encoding="unicode")


def _moves(element: ElementTree.Element) -> bool:
    return element.get("type") in MOVING


def _joint(element: ElementTree.Element, root: ElementTree.Element) -> RobotJoint:
    name, remarks = str(element.get("name")), []
    number = _Numbers(element)
    try:
        joint = RobotJoint(
            name,
            "prismatic" if element.get("type") == "prismatic" else "revolute",
            effort=number("limit", "effort") or None,
            speed=number("limit", "velocity") or None,
            damping=number("dynamics", "damping"),
            friction=number("dynamics", "friction"),
            armature=number("dynamics", "armature") or number("dynamics", "rotor_inertia"),
            stiffness=number("dynamics", "spring_stiffness") or 0.0,
        )
        if element.get("type") != "continuous" and element.find("limit") is not None:
            joint = replace(joint, low=number("limit", "lower") or 0.0, high=number("limit", "upper") or 0.0)
        for key in ("damping", "friction", "armature"):
            if (getattr(joint, key) or 0.0) < 0.0:
                raise ParameterError(f"{key} {getattr(joint, key):g}; it must be 0 or more")
        mimic = element.find("mimic")
        if mimic is not None:
            multiplier, offset = number("mimic", "multiplier"), number("mimic", "offset")
            joint = replace(
                joint,
                mimic=str(mimic.get("joint")),
                multiplier=1.0 if multiplier is None else multiplier,
                offset=offset or 0.0,
            )
        for key in ("spring_stiffness", "spring_reference"):
            if number("dynamics", key):
                remarks.append(
                    f"{key} {number('dynamics', key):g}: a device file of a rigid joint has no spring: not used"
                )
    except ParameterError as error:
        raise ParameterError(f"joint '{name}' states {error}") from None
    remarks += _transmissions(root, name)
    for each in root.iterfind(".//ros2_control/joint"):
        if each.get("name") == name:
            modes = [str(c.get("name")) for c in each.findall("command_interface")]
            remarks.append(f"ros2_control commands its {', '.join(modes) or 'nothing'}")
            if modes in (["effort"], ["position"]):
                joint = replace(joint, drive="torque" if modes == ["effort"] else "position")
    for each in root.findall("gazebo"):
        if each.get("reference") == name:
            stated = [f"{tag.tag} {(tag.text or '').strip()}" for tag in each if (tag.text or "").strip()]
            if stated:
                remarks.append(f"its gazebo element states {', '.join(stated)[:120]}: not used")
            spring = _number(each.findtext("springStiffness"), "springStiffness")
            joint = replace(joint, stiffness=joint.stiffness or spring or 0.0)
    return replace(joint, remarks=tuple(remarks))


def _transmissions(root: ElementTree.Element, name: str) -> list[str]:
    """Remarks on the transmissions of a joint, those in ros2_control elements included."""
    remarks = []
    for each in root.iter("transmission"):
        for joint in each.findall("joint"):
            if joint.get("name") != name:
                continue
            texts = [
                (part.findtext(key) or "").strip()
                for part in (joint, *each.findall("actuator"))
                for key in ("mechanicalReduction", "mechanical_reduction")
            ]
            reduction, offset = next(filter(None, texts), "1"), (joint.findtext("offset") or "").strip()
            remarks.append(
                f"transmission '{each.get('name')}' states a reduction of {reduction}"
                f"{f' and an offset of {offset} rad' if offset else ''}; its rotor's inertia "
                "times the reduction squared belongs to the inertia at the joint, and URDF has no place for it"
            )
    return remarks


@dataclass(frozen=True)
class _Numbers:
    """Numbers in the attributes of an element's children."""

    element: ElementTree.Element

    def __call__(self, tag: str, key: str) -> float | None:
        child = self.element.find(tag)
        return _number(None if child is None else child.get(key), key)


def _number(text: str | None, name: str) -> float | None:
    """The number in a text, None where there is no text. Raises ParameterError for other texts, nan and inf."""
    if text is None or not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ParameterError(f"{name} '{text.strip()}', which is no finite number")
    return value
