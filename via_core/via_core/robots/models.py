"""URDF and MJCF files as rigid bodies in pinocchio, with everything that they state about each joint.

    robot = read_robot("arm.urdf")
    robot.joint("elbow").damping          # [N m s/rad]; None: the file states none
    robot.seen_at("elbow").inertia        # [kg m^2] of all that the joint moves, other joints at rest

Meshes are never read. What a file states and a device file cannot hold becomes a remark; nothing is dropped silently.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio

from via_core.errors import DeviceError
from via_core.signals import Array
from via_core.text_files import read_text

POSES = 200  # random poses that show how far an inertia depends on the pose


@dataclass(frozen=True)
class RobotJoint:
    """What a description states about one joint; None: nothing. Units of a sliding joint: m, N, kg."""

    name: str
    kind: Literal["revolute", "prismatic"]
    low: float = -np.inf  # [rad]
    high: float = np.inf
    effort: float | None = None  # [N m] limit
    speed: float | None = None  # [rad/s] limit
    damping: float | None = None  # [N m s/rad]
    friction: float | None = None  # [N m] dry
    armature: float | None = None  # [kg m^2] of the rotor, seen at the joint
    reference: float = 0.0  # [rad] angle in the bodies' zero pose
    kp: float | None = None  # [N m/rad] of a position drive
    kd: float | None = None  # [N m s/rad]
    gear: float = 1.0  # command of a drive per angle of the joint
    delay: float | None = None  # [s] of a drive
    mimic: str = ""  # the joint that this one follows
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class SeenAtJoint:
    """Inertia and gravity of the rigid bodies about one joint while all other joints rest.

    inertia         [kg m^2] without the rotor; `lowest` and `highest` over the poses of the other joints
    gravity_torque  [N m] largest, on a joint at any of its angles; [N] constant, of a sliding joint
    gravity_angle   [rad] at which the link hangs at rest
    """

    inertia: float
    lowest: float
    highest: float
    gravity_torque: float
    gravity_angle: float


@dataclass(frozen=True, eq=False)
class Robot:
    """Rigid bodies and the joints that a description states, base first."""

    name: str
    file: str
    model: pinocchio.Model  # armature included
    joints: tuple[RobotJoint, ...]
    remarks: tuple[str, ...] = ()

    def reduced(self, names: Sequence[str]) -> pinocchio.Model:
        """The bodies with the joints `names` only; the others are fixed in the bodies' zero pose."""
        fixed = [k for k in range(1, self.model.njoints) if self.model.names[k] not in names]
        model = pinocchio.buildReducedModel(self.model, fixed, pinocchio.neutral(self.model))
        rotors = np.zeros(model.nv)
        for name in names:
            rotors[model.joints[model.getJointId(name)].idx_v] = self.joint(name).armature or 0.0
        model.armature = rotors
        return model

    def joint(self, name: str) -> RobotJoint:
        """The joint of that name. Raises DeviceError with the names that there are."""
        for each in self.joints:
            if each.name == name:
                return each
        there = ", ".join(each.name for each in self.joints) or "none that moves"
        wanted = f"no joint '{name}'; there are:" if name else "has several joints; choose with --joint from:"
        raise DeviceError(f"{self.file}: {wanted} {there}")

    def configuration(self, angles: Mapping[str, float]) -> Array:
        """pinocchio's configuration with the joints at `angles` [rad], the others in the bodies' zero pose."""
        q = pinocchio.neutral(self.model)
        for name, value in angles.items():
            joint = self.model.joints[self.model.getJointId(name)]
            value = value - self.joint(name).reference
            q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        return q

    def seen_at(self, name: str, angles: Mapping[str, float] | None = None) -> SeenAtJoint:
        """Inertia and gravity at a joint with the other joints at `angles` [rad], or in the bodies' zero pose."""
        own, pose = self.joint(name), dict(angles or {})
        for each in pose:
            self.joint(each)
        data, at = self.model.createData(), self.model.joints[self.model.getJointId(name)].idx_v
        pose.setdefault(name, own.reference)

        def inertia(angles: Mapping[str, float]) -> float:
            return float(pinocchio.crba(self.model, data, self.configuration(angles))[at, at] - self.model.armature[at])

        def gravity(angle: float) -> float:
            q = self.configuration({**pose, name: angle})
            return float(pinocchio.computeGeneralizedGravity(self.model, data, q)[at])

        rng = np.random.default_rng(0)
        ranges = {
            each.name: (max(each.low, each.reference - np.pi), min(each.high, each.reference + np.pi))
            for each in self.joints
            if each.name != name
        }
        seen = [inertia(pose)]
        for _ in range(POSES if ranges else 0):
            seen.append(inertia({each: float(rng.uniform(*ends)) for each, ends in ranges.items()}))
        if own.kind == "prismatic":
            return SeenAtJoint(seen[0], min(seen), max(seen), gravity(own.reference), 0.0)
        sine, cosine = -gravity(0.0), gravity(0.5 * np.pi)  # of G sin(q - q0), times G
        size = float(np.hypot(sine, cosine))
        angle = float(np.arctan2(sine, cosine)) + 0.0 if size > 1e-9 else 0.0
        return SeenAtJoint(seen[0], min(seen), max(seen), size if size > 1e-9 else 0.0, angle)


def read_robot(path: str | Path) -> Robot:
    """The robot of a URDF or MJCF file. Raises DeviceError in one line with the remedy."""
    path = Path(path)
    if path.suffix == ".xacro":
        raise DeviceError(f"{path}: is a xacro file; write the URDF with `xacro {path} > {path.with_suffix('')}`")
    text = read_text(path, DeviceError)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise DeviceError(f"{path}: not XML: {error}") from None
    if root.tag == "robot":
        return _urdf(path, text, root)
    if root.tag == "mujoco":
        from via_core.robots.mjcf import read_mjcf  # importing MuJoCo takes a second

        return read_mjcf(path)
    raise DeviceError(f"{path}: neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>")


def is_model(name: str | Path) -> bool:
    """Whether a name is a path of a robot description rather than of a device or an arm."""
    return Path(name).suffix.lower() in (".urdf", ".xml", ".mjcf", ".xacro")


def _urdf(path: Path, text: str, root: ElementTree.Element) -> Robot:
    if root.find(".//{http://www.ros.org/wiki/xacro}*") is not None or "<xacro:" in text:
        raise DeviceError(f"{path}: contains xacro macros; write the URDF with `xacro {path} > plain.urdf`")
    try:
        model = pinocchio.buildModelFromXML(_without_meshes(root))
    except (ValueError, RuntimeError, IndexError) as error:
        raise DeviceError(f"{path}: pinocchio cannot read it: {' '.join(str(error).split())[:160]}") from None
    elements = {str(each.get("name")): each for each in root.findall("joint")}
    joints = [_urdf_joint(elements[name], root) for name in model.names if name in elements and _moves(elements[name])]
    rotors = np.zeros(model.nv)
    for each in joints:
        rotors[model.joints[model.getJointId(each.name)].idx_v] = each.armature or 0.0
    model.armature = rotors
    odd = [str(e.get("name")) for e in elements.values() if e.get("type") in ("floating", "planar")]
    light = [str(link.get("name")) for link in root.findall("link") if link.find("inertial") is None]
    remarks = [f"joints {', '.join(odd)} float or slide in a plane: taken as fixed"] if odd else []
    child = {str(e.find("child").get("link")): e for e in elements.values() if e.find("child") is not None}  # type: ignore[union-attr]
    bare = [name for name in light if name in child and _moves(child[name])]
    if bare:
        remarks.append(f"links {', '.join(bare)} state no <inertial>: taken as massless")
    return Robot(str(root.get("name") or path.stem), str(path), model, tuple(joints), tuple(remarks))


def _without_meshes(root: ElementTree.Element) -> str:
    """The URDF without what only pictures and contacts need, so that missing meshes cannot matter."""
    copied = ElementTree.fromstring(ElementTree.tostring(root))
    for link in copied.findall("link"):
        for tag in ("visual", "collision"):
            for each in link.findall(tag):
                link.remove(each)
    for tag in ("gazebo", "transmission", "ros2_control", "material"):
        for each in copied.findall(tag):
            copied.remove(each)
    return ElementTree.tostring(copied, encoding="unicode")


def _moves(element: ElementTree.Element) -> bool:
    return element.get("type") in ("revolute", "continuous", "prismatic")


def _urdf_joint(element: ElementTree.Element, root: ElementTree.Element) -> RobotJoint:
    name, remarks = str(element.get("name")), []
    number = _Numbers(element)
    joint = RobotJoint(
        name,
        "prismatic" if element.get("type") == "prismatic" else "revolute",
        effort=number("limit", "effort") or None,
        speed=number("limit", "velocity") or None,
        damping=number("dynamics", "damping"),
        friction=number("dynamics", "friction"),
        armature=number("dynamics", "armature") or number("dynamics", "rotor_inertia"),
    )
    if element.get("type") != "continuous" and element.find("limit") is not None:
        joint = replace(joint, low=number("limit", "lower") or 0.0, high=number("limit", "upper") or 0.0)
    mimic = element.find("mimic")
    if mimic is not None:
        joint = replace(joint, mimic=str(mimic.get("joint")))
        remarks.append(
            f"follows joint {mimic.get('joint')} by a factor {mimic.get('multiplier', '1')}: the inertia that it adds "
            "there is left out"
        )
    for each in root.findall("transmission"):
        for transmitted in each.findall("joint"):
            if transmitted.get("name") == name:
                reduction = each.findtext(".//mechanicalReduction")
                remarks.append(
                    f"transmission '{each.get('name')}' states a reduction of {reduction or 1}; its rotor's inertia "
                    "times the reduction squared belongs to the inertia at the joint, and URDF has no place for it"
                )
    for each in root.iterfind(".//ros2_control/joint"):
        if each.get("name") == name:
            modes = [str(c.get("name")) for c in each.findall("command_interface")]
            remarks.append(f"ros2_control commands its {', '.join(modes) or 'nothing'}")
    for each in root.findall("gazebo"):
        if each.get("reference") == name:
            stated = [f"{tag.tag} {(tag.text or '').strip()}" for tag in each if (tag.text or "").strip()]
            if stated:
                remarks.append(f"its gazebo element states {', '.join(stated)[:120]}: not used")
    for key in ("spring_stiffness", "spring_reference"):
        if number("dynamics", key):
            remarks.append(f"{key} {number('dynamics', key):g}: a device file of a rigid joint has no spring: not used")
    return replace(joint, remarks=tuple(remarks))


@dataclass(frozen=True)
class _Numbers:
    """Numbers in the attributes of an element's children."""

    element: ElementTree.Element

    def __call__(self, tag: str, key: str) -> float | None:
        child = self.element.find(tag)
        text = None if child is None else child.get(key)
        if text is None or not re.fullmatch(r"\s*[-+]?[0-9.]+(?:[eE][-+]?\d+)?\s*", text):
            return None
        return float(text)
