"""Arms of rigid joints: the bodies between them, from a URDF or MJCF file, and the torques that their motion requires.

tau = M(q) qdd + c(q, qd) + g(q)        recursive Newton-Euler in pinocchio; rotors are armature

arm = load_arm("dfki_double_pendulum")
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio
from pydantic import Field
from scipy.signal import savgol_coeffs, savgol_filter
from via_core.arm_files import ArmFile, read_arm
from via_core.devices import Device, load_device, parse_device
from via_core.errors import DeviceError, SignalError
from via_core.recordings.entries import Constants
from via_core.robots.description import TORQUE, Number
from via_core.robots.models import is_model, read_robot
from via_core.signals import Array, Indices

from via_gap.run.describe import Recorded, described

NONE = Constants()
# Forces of other joints scale with no number of a joint's device, as its own inertia, friction and gravity do.
TORQUE_SCALE = Number(1.0, "guessed", "torque that acts per torque that is recorded", TORQUE)
SMOOTHING = 0.03  # [s] half width of the smoothing filter for velocity and acceleration


class RigidArmFile(ArmFile):
    """One YAML per arm: its joints base first; those of its URDF have the names of the devices' links."""

    name: str
    title: str
    source: Annotated[tuple[str, ...], Field(min_length=1)]
    confidence: str
    joints: Annotated[tuple[str, ...], Field(min_length=2)]  # device names, or paths beside this file
    rotors: tuple[Annotated[float, Field(ge=0.0)], ...] = ()  # [kg m^2] seen at the joints; none: in the URDF's links


@dataclass(frozen=True, eq=False)
class Arm:
    """Rigid joints and the bodies between them."""

    name: str
    devices: tuple[Device, ...]  # one per joint, base first
    model: pinocchio.Model  # rotors as armature
    order: Indices  # (n,) index of each device's joint in the model's vectors
    reference: Array | None = None  # (n,) [rad] angles in the zero pose of the model; None: 0
    lift: pinocchio.Model | None = None  # the same tree with the masses whose weight the robot compensates
    remarks: tuple[str, ...] = ()  # on what the model states and the devices lack

    def torques(self, angle: Array, velocity: Array, acceleration: Array) -> Array:
        """Drive torques (N, n) [N m] of a motion (N, n each) [rad, rad/s, rad/s^2] without any friction."""
        data = self.model.createData()
        lifted = None if self.lift is None else self.lift.createData()
        out = np.empty_like(angle)
        v, a = np.zeros(self.model.nv), np.zeros(self.model.nv)
        for k in range(len(angle)):
            v[self.order], a[self.order] = velocity[k], acceleration[k]
            q = self.configuration(angle[k])
            out[k] = pinocchio.rnea(self.model, data, q, v, a)[self.order]
            if lifted is not None:
                out[k] -= pinocchio.computeGeneralizedGravity(self.lift, lifted, q)[self.order]
        return out

    def configuration(self, angle: Array) -> Array:
        """pinocchio's q for angles (n,) [rad]: a joint without end stops is represented by cosine and sine."""
        q = pinocchio.neutral(self.model)
        angle = angle if self.reference is None else angle - self.reference
        for joint, value in zip(self.model.joints[1:], angle[np.argsort(self.order)], strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        return q


def load_arm(name_or_path: str | Path) -> Arm:
    """The shipped arm of that name, or the one a YAML file describes. Raises DeviceError in one line."""
    path, file, model = read_arm(RigidArmFile, "arms", name_or_path)
    beside = [path.parent / joint if joint.endswith((".yaml", ".yml")) else joint for joint in file.joints]
    return _built(path.name, file, tuple(map(load_device, beside)), model)


def find_arm(name: str, recording: Path, constants: Constants = NONE) -> Arm:
    """The arm of a URDF or MJCF file, with the joints in the recording, or the one that `load_arm` finds."""
    return arm_of_model(Path(name), recording, constants) if is_model(name) else load_arm(name)


def arm_of_model(model: Path, recording: Path, constants: Constants = NONE) -> Arm:
    """The arm of a URDF or MJCF file, with the joints that a recording contains; the others are fixed at zero.

    Raises ViaError where the recording has positions of no joint of the model, or goals of a drive without gains: the
    missing torque of an equation that contains them is smallest where all its numbers are small.
    """
    robot = read_robot(model)
    recorded = Recorded.of(recording, robot)
    seen = {guess.joint for guess in recorded.guesses if guess.quantity == "position"}
    joints = [each for each in robot.joints if each.name in seen and not each.mimic]
    if not joints:
        there = ", ".join(sorted(seen - {""})) or "none with a name"
        names = ", ".join(each.name for each in robot.joints)
        raise SignalError(f"{recording}: has no joint of {model}, which has: {names}; the recording has: {there}")
    found = [described("arm", robot, each.name, recorded, {}, constants) for each in joints]
    without = [each.joint for each in found if each.drive == "position" and each.numbers["kp"].origin != "read"]
    if without:
        raise SignalError(
            f"{recording}: has goals and no torques, and {model} no gains of the position drive of "
            f"{', '.join(without)}: state the gains in an MJCF model (<position kp=... kv=...>), record currents, or "
            "diagnose one joint while the others rest: via device new"
        )
    for each in found:
        if each.drive == "torque":
            each.numbers["torque_scale"] = TORQUE_SCALE
    devices = tuple(parse_device(each.text(), each.joint) for each in found)
    reduced, lift = robot.reduced([each.name for each in joints])
    own = [f"{each.joint}: {text}" for each in found for text in each.remarks if text not in robot.remarks]
    own += [
        f"{each.mimic}: an arm includes inertia and friction of {each.name}, but not its gravity"
        for joint in joints
        for each in robot.following(joint.name)
    ]
    order = np.array([reduced.joints[reduced.getJointId(each.name)].idx_v for each in joints], dtype=np.intp)
    reference = np.array([each.reference for each in joints])
    return Arm(robot.name, devices, reduced, order, reference, lift, (*robot.remarks, *own))


def _built(shown: str, file: RigidArmFile, devices: tuple[Device, ...], model: pinocchio.Model) -> Arm:
    for device in devices:
        if device.arrangement != "rigid":
            raise DeviceError(f"{shown}: joint '{device.name}' is {device.arrangement}, an arm's joints must be rigid")
        if not model.existJointName(device.link_joint):
            raise DeviceError(f"{shown}: no joint '{device.link_joint}' of '{device.name}' in {file.urdf}")
    if model.nv != len(devices):
        raise DeviceError(f"{shown}: {file.urdf} has {model.nv} joints that move, {len(devices)} are described")
    if len(file.rotors) not in (0, len(devices)):
        raise DeviceError(f"{shown}: rotors needs 0 or {len(devices)} numbers, got {len(file.rotors)}")
    order = np.array([model.joints[model.getJointId(device.link_joint)].idx_v for device in devices], dtype=np.intp)
    if file.rotors:
        armature = np.zeros(model.nv)
        armature[order] = file.rotors
        model.armature = armature
    return Arm(file.name, devices, model, order)


def with_numbers(arm: Arm, link: str, numbers: Array) -> Arm:
    """The arm whose body at the joint `link` has `numbers` (10,) more, in pinocchio's order.

    Raises SignalError if the arm has no such joint.
    """
    model, body = arm.model.copy(), body_of(arm, joint_number(arm, link))
    model.inertias[body] = pinocchio.Inertia.FromDynamicParameters(model.inertias[body].toDynamicParameters() + numbers)
    return replace(arm, model=model)


def joint_number(arm: Arm, name: str) -> int:
    """Number of a joint, from the base. Raises SignalError if the arm has no such joint."""
    names = [each.name for each in arm.devices]
    if name not in names:
        raise SignalError(f"'{arm.name}' has no joint '{name}'; it has: {', '.join(names)}")
    return names.index(name)


def under(arm: Arm, gravity: Array) -> Arm:
    """The arm under a gravity (3,) [m/s^2] in the frame of its base."""
    model, lift = arm.model.copy(), None if arm.lift is None else arm.lift.copy()
    for each in (model, lift):
        if each is not None:
            each.gravity.linear = gravity
    return replace(arm, model=model, lift=lift)


def body_of(arm: Arm, joint: int) -> int:
    """Number in the model of the body that a joint of the arm moves."""
    return next(i for i, each in enumerate(arm.model.joints) if i and each.idx_v == arm.order[joint])


def smoothed_motion(time: Array, angle: Array, degree: int = 3) -> tuple[Array, Array, Array]:
    """Smoothed angles, velocities and accelerations (N, n each) at the stamps; gaps are interpolated.

    degree  of the local polynomials: with 5, accelerations have less bias and more noise than with 3
    """
    period = float(np.median(np.diff(time)))
    half = _half_width(period, degree)
    if len(time) <= 2 * half + 1:
        raise SignalError(f"{len(time)} samples are too few for velocities")
    grid = np.linspace(time[0], time[-1], round((time[-1] - time[0]) / period) + 1)
    there = np.isfinite(angle)
    even = [np.interp(grid, time[seen], column[seen]) for column, seen in zip(angle.T, there.T, strict=True)]

    def derivative(order: int) -> Array:
        smooth = [savgol_filter(each, 2 * half + 1, degree, deriv=order, delta=grid[1] - grid[0]) for each in even]
        return np.stack([np.interp(time, grid, each) for each in smooth], axis=1)

    return derivative(0), derivative(1), derivative(2)


def velocity_noise(time: Array, angle: Array, smooth: Array, degree: int = 3) -> Array:
    """Standard deviations (n,) [rad/s] of smoothed velocities, from the distances of angles (N, n) from smooth ones."""
    period = float(np.median(np.diff(time)))
    weights = savgol_coeffs(2 * _half_width(period, degree) + 1, degree, deriv=1, delta=period)
    return np.nanstd(angle - smooth, axis=0) * float(np.linalg.norm(weights))


def _half_width(period: float, degree: int) -> int:
    """Samples on either side of the middle of the smoothing filter, more than its polynomials fit exactly."""
    return max(degree // 2 + 1, round(SMOOTHING / period))
