"""URDF and MJCF files as rigid bodies in pinocchio, with everything that they state about each joint.

    robot = read_robot("arm.urdf")
    robot.joint("elbow").damping          # [N m s/rad]; None: the file states none
    robot.seen_at("elbow").inertia        # [kg m^2] of all that the joint moves, other joints at rest

Meshes are never read. What a file states and a device file cannot hold becomes a remark; nothing is dropped silently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio

from via_core.errors import DeviceError
from via_core.signals import Array
from via_core.text_files import read_text

POSES = 200  # random poses that show how far an inertia depends on the pose
GRAVITY_ANGLES = 13  # angles of a joint at which its gravity is compared with a sine


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
    ki: float = 0.0  # [N m/(rad s)]
    integral_limit: float | None = None  # [N m]
    slew: float | None = None  # [rad/s] limit on the speed of the goal
    limited: Literal["sum", "proportional"] = "sum"  # what `effort` limits: kp (goal - q) with or without kd qd
    drive: Literal["", "torque", "position"] = ""  # what commands of its actuator are; '': not stated
    gear: float = 1.0  # of a position drive: command per angle; of a torque drive: torque per command
    bias: float = 0.0  # [N m] constant torque of the drive
    delay: float | None = None  # [s] of a drive
    stiffness: float = 0.0  # [N m/rad] of a spring in the joint
    mimic: str = ""  # the joint that this one follows: angle = multiplier * its angle + offset
    multiplier: float = 1.0
    offset: float = 0.0  # [rad]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class SeenAtJoint:
    """Inertia and gravity of the rigid bodies about one joint while all others rest, but for those that follow it.

    inertia         [kg m^2] without the rotor; `lowest` and `highest` over the poses of the other joints
    gravity_torque  [N m] largest, on a joint at any of its angles; [N] constant, of a sliding joint
    gravity_angle   [rad] at which the link hangs at rest
    gravity_error   [N m] largest difference of the gravity from a sine, or from a constant of a sliding joint
    """

    inertia: float
    lowest: float
    highest: float
    gravity_torque: float
    gravity_angle: float
    gravity_error: float


@dataclass(frozen=True, eq=False)
class Robot:
    """Rigid bodies and the joints that a description states, base first."""

    name: str
    file: str
    model: pinocchio.Model  # armature included
    joints: tuple[RobotJoint, ...]
    remarks: tuple[str, ...] = ()
    lift: pinocchio.Model | None = None  # the same tree with the masses whose weight the robot compensates

    def reduced(self, names: Sequence[str]) -> tuple[pinocchio.Model, pinocchio.Model | None]:
        """The bodies, and `lift`, with the joints `names` only; the others are fixed in the bodies' zero pose.

        Joints that follow one of `names` add their inertia in that pose as armature, but not their gravity.
        """
        fixed = [k for k in range(1, self.model.njoints) if self.model.names[k] not in names]
        zero = self.configuration({})
        model = pinocchio.buildReducedModel(self.model, fixed, zero)
        lift = None if self.lift is None else pinocchio.buildReducedModel(self.lift, fixed, zero)
        mass, rotors = self._mass_matrix(zero), np.zeros(model.nv)
        for name in names:
            own, moved = self._index(name), self._moved(name)
            following = moved @ mass @ moved - mass[own, own]
            rotors[model.joints[model.getJointId(name)].idx_v] = (self.joint(name).armature or 0.0) + following
        model.armature = rotors
        return model, lift

    def following(self, name: str) -> list[RobotJoint]:
        """The joints that follow the joint of that name."""
        return [each for each in self.joints if each.mimic == name]

    def sprung(self, name: str) -> list[RobotJoint]:
        """The joints with springs in the part of the robot that a joint moves."""
        behind = {self.model.names[k] for k in self.model.subtrees[self.model.getJointId(name)]} - {name}
        return [each for each in self.joints if each.name in behind and each.stiffness]

    def _index(self, name: str) -> int:
        return int(self.model.joints[self.model.getJointId(name)].idx_v)

    def _moved(self, name: str) -> Array:
        """Velocities (nv,) of all joints per velocity of one of them."""
        moved = np.zeros(self.model.nv)
        moved[self._index(name)] = 1.0
        for each in self.following(name):
            moved[self._index(each.name)] = each.multiplier
        return moved

    def _mass_matrix(self, q: Array) -> Array:
        """Inertia (nv, nv) of the bodies without rotors."""
        upper = np.triu(pinocchio.crba(self.model, self.model.createData(), q))
        return np.asarray(upper + np.triu(upper, 1).T - np.diag(self.model.armature))

    def joint(self, name: str) -> RobotJoint:
        """The joint of that name. Raises DeviceError with the names that there are."""
        for each in self.joints:
            if each.name == name:
                return each
        there = ", ".join(each.name for each in self.joints) or "none that moves"
        wanted = f"no joint '{name}'; there are:" if name else "has several joints; choose with --joint from:"
        raise DeviceError(f"{self.file}: {wanted} {there}")

    def configuration(self, angles: Mapping[str, float]) -> Array:
        """pinocchio's configuration with the joints at `angles` [rad], the others in the bodies' zero pose.

        Joints without an angle that follow another are where it takes them.
        """
        q, masters = pinocchio.neutral(self.model), {each.name: each for each in self.joints}
        pose = {
            each.name: each.multiplier * angles.get(each.mimic, masters[each.mimic].reference) + each.offset
            for each in self.joints
            if each.mimic in masters
        }
        for name, value in {**pose, **angles}.items():
            joint = self.model.joints[self.model.getJointId(name)]
            value = value - self.joint(name).reference
            q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        return q

    def seen_at(self, name: str, angles: Mapping[str, float] | None = None) -> SeenAtJoint:
        """Inertia and gravity at a joint with the other joints at `angles` [rad], or in the bodies' zero pose."""
        own, pose, moved = self.joint(name), dict(angles or {}), self._moved(name)
        for each in pose:
            self.joint(each)
        pose.setdefault(name, own.reference)

        def inertia(angles: Mapping[str, float]) -> float:
            return float(moved @ self._mass_matrix(self.configuration(angles)) @ moved)

        def gravity(angle: float) -> float:
            q = self.configuration({**pose, name: angle})
            weight = pinocchio.computeGeneralizedGravity(self.model, self.model.createData(), q)
            if self.lift is not None:
                weight = weight - pinocchio.computeGeneralizedGravity(self.lift, self.lift.createData(), q)
            return float(moved @ weight)

        rng = np.random.default_rng(0)
        follows = self.following(name)
        ranges = {
            each.name: (max(each.low, each.reference - np.pi), min(each.high, each.reference + np.pi))
            for each in self.joints
            if (each.name != name or follows) and not each.mimic
        }
        seen = [inertia(pose)]
        for _ in range(POSES if ranges else 0):
            seen.append(inertia({each: float(rng.uniform(*ends)) for each, ends in ranges.items()}))
        extent = seen[0], min(seen), max(seen)
        limited = follows and np.isfinite([own.low, own.high]).all() and own.low < own.high
        at = np.linspace(*((own.low, own.high) if limited else (-np.pi, np.pi)), GRAVITY_ANGLES)
        if own.kind == "prismatic":
            constant = gravity(own.reference)
            error = max(abs(gravity(each) - constant) for each in at) if follows else 0.0
            return SeenAtJoint(*extent, constant, 0.0, error)
        torque, waves = np.array([gravity(each) for each in at]), np.stack([np.sin(at), np.cos(at)], axis=1)
        fitted, *_ = np.linalg.lstsq(waves, torque, rcond=None)  # G cos(q0) and -G sin(q0) of G sin(q - q0)
        size = float(np.hypot(*fitted))
        angle = round(float(np.arctan2(-fitted[1], fitted[0])), 9) + 0.0 if size > 1e-9 else 0.0
        error = float(np.abs(waves @ fitted - torque).max())
        return SeenAtJoint(*extent, size if size > 1e-9 else 0.0, angle, error)


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
        from via_core.robots.urdf import read_urdf

        return read_urdf(path, text, root)
    if root.tag == "mujoco":
        from via_core.robots.mjcf import read_mjcf  # importing MuJoCo takes a second

        return read_mjcf(path)
    raise DeviceError(f"{path}: neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>")


def is_model(name: str | Path) -> bool:
    """Whether a name is a path of a robot description rather than of a device or an arm."""
    return Path(name).suffix.lower() in (".urdf", ".xml", ".mjcf", ".xacro")
