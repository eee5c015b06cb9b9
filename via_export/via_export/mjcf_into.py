"""Write a joint into a given MuJoCo model: attributes in place; motors, tendons, actuators and sensors beside it.

The file is edited and not rewritten, so that comments, classes and assets stay. Mass and inertia of the given bodies
are kept; payloads become bodies, other changes of inertia armature.
"""

from __future__ import annotations

from math import pi
from typing import Any

import mujoco
import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_sim.joint.parameters import LINK, P
from via_sim.plants import GRAVITY

from via_export import payloads
from via_export.mjcf import Parts, joint_parts
from via_export.mjcf_timing import has_memory, integrator, step
from via_export.target import Target
from via_export.xml import Element, child, element, text

SMALL = 1e-9  # relative change of a number that counts as none
ROUNDED = 1e-4  # relative change of a weight that is not worth an edit by hand: device files round their numbers
TARGETS = ("joint", "jointinparent")


def into(root: Element, target: Target, name: str, model: Any) -> list[str]:
    """Edit the model `root` in place; `model` is the same, compiled. Returns notes for the user.

    Raises ParameterError if it is a URDF, has no hinge or slide of that name, or has it in an included file.
    """
    if root.tag == "robot":
        raise ParameterError("the given model is a URDF: use --to urdf, or leave --into away")
    body, joint = _find(root, name, model)
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    in_degrees = _in_degrees(root)
    kept = float(model.qpos0[model.jnt_qposadr[number]])
    parts = joint_parts(target, name, kept)
    given = model.jnt_range[number] if model.jnt_limited[number] else None
    notes = _joint_attributes(joint, parts, target, in_degrees, given)
    turn = _frame_quaternion(model.jnt_axis[number])
    if parts.in_link:
        body.append(element("frame", *parts.in_link, pos=model.jnt_pos[number], quat=turn))
    if parts.bodies:
        parent = next(each for each in root.iter() if body in list(each))
        at, own = np.zeros(3), np.zeros(4)
        index = int(model.jnt_bodyid[number])
        mujoco.mju_rotVecQuat(at, model.jnt_pos[number], model.body_quat[index])
        mujoco.mju_mulQuat(own, model.body_quat[index], turn)
        parent.append(element("frame", *parts.bodies, pos=model.body_pos[index] + at, quat=own))
    notes += _mass(body, joint, target, model, number)
    notes += _actuators(root, parts, name, model)
    for section, children in (("tendon", parts.tendons), ("actuator", parts.actuators), ("sensor", parts.sensors)):
        if children:
            child(root, section).extend(children)
    if model.opt.timestep > step(target) * (1.0 + SMALL):
        best = integrator(target)
        notes.append(
            f"option timestep: {model.opt.timestep:g} s; this joint needs {step(target):.3g} s, best with {best}"
        )
    if has_memory(target) and model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        notes.append("option integrator: RK4 holds bristles and slipping springs over its stages; take Euler")
    return notes


def _find(root: Element, name: str, model: Any) -> tuple[Element, Element]:
    found = [(body, joint) for body in root.iter("body") for joint in body if joint.get("name") == name]
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if number < 0:
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
        raise ParameterError(f"the model has no joint '{name}'; there are: {', '.join(map(str, names)) or 'none'}")
    if not found:
        raise ParameterError(f"joint '{name}' is in an included file: give that file, or the model saved as one file")
    if int(model.jnt_type[number]) not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
        raise ParameterError(f"joint '{name}' is neither a hinge nor a slide")
    return found[0]


def _in_degrees(root: Element) -> bool:
    angles = [each.get("angle") for each in root.iter("compiler") if each.get("angle")]
    return (angles[-1] if angles else "degree") == "degree"


def _joint_attributes(joint: Element, parts: Parts, target: Target, in_degrees: bool, given: Array | None) -> list[str]:
    """Set friction, encoder offset and wall; numbers of angles in the unit of the file.

    given  (2,) [rad] range of the joint in the model; None: not limited
    """
    unit = 180.0 / pi if in_degrees else 1.0
    wanted = {key: value for key, value in parts.joint.items() if key not in ("name", "type", "axis")}
    for key, neutral in (("damping", "0"), ("frictionloss", "0")):
        wanted.setdefault(key, neutral)
    notes = []
    offset = target.of_axis(P.encoder_offset, LINK)
    if offset == 0.0 and joint.get("ref") is None:
        wanted.pop("ref")
    if offset and given is not None:
        notes.append(
            f"joint range and ref are shifted by the encoder offset of {offset:.6g} rad; shift keyframes likewise"
        )
        wanted.setdefault("range", (given + offset).tolist())
    if given is not None and target.row[P.contact_stiffness] > 0.0:
        above = target.row[P.contact_side] > 0.0
        wall = float(target.row[P.contact_angle])
        ends = (float(given[0]), wall) if above else (wall, float(given[1]))
        wanted["range"] = (ends[0] + offset, ends[1] + offset)
        notes.append(
            f"the {'upper' if above else 'lower'} end of the joint's range is replaced by the wall; the other end "
            "becomes as soft as the wall"
        )
    for key, value in wanted.items():
        if key in ("ref", "range", "springref"):
            value = np.asarray(value, dtype=float) * unit
            value = value.tolist() if value.ndim else float(value)
        joint.set(key, text(value))  # type: ignore[arg-type]
    return notes


def _frame_quaternion(axis: Array) -> Array:
    """Quaternion of a frame whose z is the axis."""
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, axis)
    return turn


def _mass(body: Element, joint: Element, target: Target, model: Any, number: int) -> list[str]:
    """Payloads as bodies in the direction of the weight; other changes of inertia as armature."""
    direction = _weight_direction(model, number)
    for point in payloads.payloads_of(target.effects, str(joint.get("name")), direction):
        body.append(point.body(model.jnt_pos[number]))
    inertia, gravity = payloads.moments(target.effects)
    notes = []
    change = target.inertia - float(target.nominal[P.inertia + LINK]) - inertia
    if abs(change) > SMALL * target.inertia:
        armature = float(model.dof_armature[model.jnt_dofadr[number]]) + change
        joint.set("armature", text(max(armature, 0.0)))
        if armature < 0.0:
            notes.append(
                f"inertia about the joint: lower that of the body by {-armature:.6g} kg m^2; armature ends at 0"
            )
    before, after = (float(row[P.gravity_torque]) for row in (target.nominal, target.row))
    weight = np.copysign(1.0, before) * (after - before) - gravity * (target.nominal[P.gravity] != 0.0)
    if abs(weight) > ROUNDED * max(target.gravity_torque, 1e-3):
        notes.append(
            f"gravity torque: change mass times distance of the centre of the body by {weight / GRAVITY:.6g} kg m"
        )
    turned = float(target.row[P.gravity_angle] - target.nominal[P.gravity_angle])
    if turned:
        notes.append(f"gravity angle: turn the centre of mass of the body by {-turned:.6g} rad about the joint")
    return notes


def _weight_direction(model: Any, number: int) -> Array:
    """Unit vector (3,) in the body's frame from the joint to the centre of mass behind it, across the axis."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index = int(model.jnt_bodyid[number])
    rotation = data.xmat[index].reshape(3, 3)
    centre = rotation.T @ (data.subtree_com[index] - data.xpos[index]) - model.jnt_pos[number]
    return payloads.across(centre, model.jnt_axis[number])


def _actuators(root: Element, parts: Parts, name: str, model: Any) -> list[str]:
    """Remove present actuators of the joint; the new drive of a rigid joint takes the place of the first.

    It keeps the name and the limits of the actuator that it replaces.
    """
    notes = []
    drive = next((each for each in parts.actuators if each.get("name") == f"{name}_drive"), None)
    present = _compiled_actuators(model, name)
    for section in root.findall("actuator"):
        for at, old in enumerate(list(section)):
            if name not in [old.get(key) for key in TARGETS]:
                continue
            section.remove(old)
            label = old.get("name") or "without a name"
            if drive is not None and drive in parts.actuators:
                parts.actuators.remove(drive)
                if old.get("name"):
                    drive.set("name", str(old.get("name")))
                _keep_limits(drive, model, present[0])
                section.insert(at, drive)
                notes.append(f"actuator '{label}' is replaced by that of the device")
            else:
                notes.append(f"actuator '{label}' of the joint is removed")
    return notes


def _compiled_actuators(model: Any, name: str) -> list[int]:
    """Numbers of the actuators of a joint, in the order of the file."""
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    kinds = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    on = np.isin(model.actuator_trntype, kinds) & (model.actuator_trnid[:, 0] == joint)
    return [int(each) for each in np.flatnonzero(on)]


def _keep_limits(drive: Element, model: Any, old: int) -> None:
    """Narrow the limits of a new drive, whose gear is 1, to those of the actuator that it replaces.

    The control of a torque drive is a torque [N m], that of a position drive an angle [rad].
    """
    gear, gain = float(model.actuator_gear[old, 0]), float(model.actuator_gainprm[old, 0])
    by_position = drive.get("input") == "pos"
    per_control = (1.0 / gear if gear else 0.0) if by_position else gear * gain
    affine = int(model.actuator_biastype[old]) != int(mujoco.mjtBias.mjBIAS_NONE)
    control = int(model.actuator_ctrladr[old])
    if model.actuator_ctrlnum[old] and model.actuator_ctrllimited[control] and affine == by_position:
        _narrow(drive, "ctrl", model.actuator_ctrlrange[control] * per_control)
    if model.actuator_forcelimited[old]:
        _narrow(drive, "force", model.actuator_forcerange[old] * gear)


def _narrow(drive: Element, what: str, ends: Array) -> None:
    low, high = np.sort(ends)
    present = drive.get(f"{what}range")
    if present is not None:
        now = [float(each) for each in present.split()]
        low, high = max(low, now[0]), min(high, now[1])
    if low < high:
        drive.set(f"{what}range", text((float(low), float(high))))
        drive.set(f"{what}limited", "true")
