"""Write a joint into a given MuJoCo model: attributes in place; motors, tendons, actuators and sensors beside it.

The file is edited and not rewritten, so that comments, classes and assets stay. Mass and inertia of the given bodies
are kept; payloads become bodies, other changes of inertia armature.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_sim.joint.parameters import LINK, P

from via_export import notes, payloads
from via_export.mjcf import Parts, joint_parts
from via_export.mjcf_given import WHOLE, GivenJoint
from via_export.mjcf_timing import has_memory, integrator, step
from via_export.target import Target
from via_export.xml import Element, child, element, text

TARGETS = ("joint", "jointinparent")
POLYNOMIALS = {"damping": "dof_dampingpoly", "stiffness": "jnt_stiffnesspoly"}  # of a joint, beyond the linear term


def into(root: Element, target: Target, name: str, path: Path) -> list[str]:
    """Edit the model `root` of file `path` in place. Returns notes for the user.

    Raises ParameterError if it has no hinge or slide of that name, or has it or its actuator in an included file.
    """
    given = GivenJoint.of(root, path, name)
    model, number = given.model, given.number
    parts = joint_parts(target, name, float(model.qpos0[model.jnt_qposadr[number]]))
    found = _joint_attributes(given, parts, target)
    found += _mass(given, target)
    given.without_defaults(parts)
    found += _actuators(given, parts)
    _bodies(given, parts)
    for section, children in (("tendon", parts.tendons), ("actuator", parts.actuators), ("sensor", parts.sensors)):
        if not children:
            continue
        there, names = child(root, section), {each.get("name") for each in children}
        for old in [each for each in there if each.get("name") in names]:  # of an earlier export
            there.remove(old)
            found.append(f"{section} '{old.get('name')}' is replaced")
        there.extend(children)
    if model.opt.timestep > step(target) * (1.0 + notes.SMALL):
        best = integrator(target)
        found.append(
            f"option timestep: {model.opt.timestep:g} s; this joint needs {step(target):.3g} s, best with {best}"
        )
    if has_memory(target) and model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        found.append("option integrator: RK4 holds bristles and slipping springs over its stages; take Euler")
    return found


def _bodies(given: GivenJoint, parts: Parts) -> None:
    """Sites in the joint's body, and motors beside it, in frames whose z is the joint's axis."""
    model, number = given.model, given.number
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, model.jnt_axis[number])
    if parts.in_link:
        given.body.append(element("frame", *parts.in_link, pos=model.jnt_pos[number], quat=turn))
    if not parts.bodies:
        return
    given.require_inertials()
    for body in parts.bodies:
        for joint in body.iter("joint"):
            given.state_angles_in_its_unit(joint)
    at, own, index = np.zeros(3), np.zeros(4), int(model.jnt_bodyid[number])
    mujoco.mju_rotVecQuat(at, model.jnt_pos[number], model.body_quat[index])
    mujoco.mju_mulQuat(own, model.body_quat[index], turn)
    given.parent.append(element("frame", *parts.bodies, pos=model.body_pos[index] + at, quat=own))


def _joint_attributes(given: GivenJoint, parts: Parts, target: Target) -> list[str]:
    """Set friction, spring, encoder offset and wall."""
    model, number = given.model, given.number
    wanted = {key: value for key, value in parts.joint.items() if key not in ("name", "type", "axis")}
    for key in ("damping", "frictionloss"):
        wanted.setdefault(key, 0.0)
    if np.any(given.spec.joint(given.name).springdamper):  # it would replace the damping
        wanted = {"stiffness": float(model.jnt_stiffness[number])} | wanted | {"springdamper": (0.0, 0.0)}
    ends = model.jnt_range[number] if model.jnt_limited[number] else None
    offset = target.of_axis(P.encoder_offset, LINK)
    if offset == 0.0:
        wanted.pop("ref")
    found = []
    if offset and ends is not None:
        found.append(
            f"joint range and ref are shifted by the encoder offset of {offset:.6g} "
            f"{'m' if given.slides else 'rad'}; shift keyframes likewise"
        )
        wanted.setdefault("range", (ends + offset).tolist())
    if ends is not None and target.row[P.contact_stiffness] > 0.0:
        above = target.row[P.contact_side] > 0.0
        wall = float(target.row[P.contact_angle])
        wanted["range"] = np.add((ends[0], wall) if above else (wall, ends[1]), offset).tolist()
        found.append(
            f"the {'upper' if above else 'lower'} end of the joint's range is replaced by the wall; the other end "
            "becomes as soft as the wall"
        )
    linear = {"damping": model.dof_damping[given.dof], "frictionloss": model.dof_frictionloss[given.dof]}
    linear["stiffness"] = model.jnt_stiffness[number]
    found += notes.replaced(
        {key: (float(old), float(text(wanted[key]).split()[0])) for key, old in linear.items() if key in wanted}
    )
    for key, poly in POLYNOMIALS.items():  # a shorter polynomial would keep the terms of its class
        of = given.dof if key == "damping" else number
        if key in wanted and np.any(getattr(model, poly)[of]):
            wanted[key] = " ".join([*text(wanted[key]).split(), "0", "0"][:3])
    given.edit(wanted)
    return found


def _mass(given: GivenJoint, target: Target) -> list[str]:
    """Payloads as bodies in the direction of the weight; other changes of inertia as armature."""
    model, number = given.model, given.number
    change, found = notes.inertia_added(target, target.inertia), []
    if given.slides:
        change += payloads.moments(target.effects)[0]
        found += notes.sliding_payload(target)
    elif points := payloads.payloads_of(target.effects, given.name, _weight_direction(model, number)):
        given.require_inertials()
        given.body.extend(point.body(model.jnt_pos[number]) for point in points)
    if abs(change) > notes.SMALL * target.inertia:
        armature = float(model.dof_armature[given.dof]) + change
        given.joint.set("armature", text(max(armature, 0.0)))
        if armature < 0.0:
            unit = "kg" if given.slides else "kg m^2"
            found.append(f"inertia about the joint: lower that of the body by {-armature:.6g} {unit}; armature is 0")
    return found + notes.weight(target, "the body")


def _weight_direction(model: Any, number: int) -> Array:
    """Unit vector (3,) in the body's frame from the joint to the centre of mass behind it, across the axis."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index = int(model.jnt_bodyid[number])
    rotation = data.xmat[index].reshape(3, 3)
    centre = rotation.T @ (data.subtree_com[index] - data.xpos[index]) - model.jnt_pos[number]
    return payloads.across(centre, model.jnt_axis[number])


def _actuators(given: GivenJoint, parts: Parts) -> list[str]:
    """Remove present actuators of the joint; the new drive of a rigid joint takes the place of the first.

    It keeps the name and the limits of the actuator that it replaces. Raises ParameterError if there are others, in an
    included file.
    """
    name, model, present = given.name, given.model, _compiled_actuators(given)
    old = [
        (section, each)
        for section in given.root.findall("actuator")
        for each in section
        if name in [each.get(key) for key in TARGETS]
    ]
    if len(old) < len(present):
        raise ParameterError(f"an actuator of joint '{name}' is in an included file, where it would stay: {WHOLE}")
    drive = next((each for each in parts.actuators if each.get("name") == f"{name}_drive"), None)
    found = []
    for section, each in old:
        at, label = list(section).index(each), each.get("name") or "without a name"
        section.remove(each)
        if drive is not None and drive in parts.actuators:
            parts.actuators.remove(drive)
            if each.get("name"):
                drive.set("name", str(each.get("name")))
            _keep_limits(drive, model, present[0])
            section.insert(at, drive)
            control = _controls(drive, given, present[0])
            found.append(f"actuator '{label}' is replaced by that of the device; {control}")
        else:
            found.append(f"actuator '{label}' of the joint is removed")
    return found


def _compiled_actuators(given: GivenJoint) -> list[int]:
    """Numbers of the actuators of the joint, in the order of the file."""
    model = given.model
    kinds = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    on = np.isin(model.actuator_trntype, kinds) & (model.actuator_trnid[:, 0] == given.number)
    return [int(each) for each in np.flatnonzero(on)]


def _by_position(model: Any, actuator: int) -> bool:
    return int(model.actuator_biastype[actuator]) != int(mujoco.mjtBias.mjBIAS_NONE)


def _controls(drive: Element, given: GivenJoint, old: int) -> str:
    """What the control of the new drive is, and what a control of 1 was before."""
    model = given.model
    gear, gain = float(model.actuator_gear[old, 0]), float(model.actuator_gainprm[old, 0])
    torque, position = ("force in N", "position in m") if given.slides else ("torque in N m", "angle in rad")
    now = f"its control is now the {position if drive.get('input') == 'pos' else torque}"
    if int(model.actuator_gaintype[old]) == int(mujoco.mjtGain.mjGAIN_FIXED):
        if not _by_position(model, old):
            return f"{now}; a control of 1 was {gear * gain:.6g} {torque.partition(' in ')[2]}"
        if gear and model.actuator_biasprm[old, 1] == -gain:
            return f"{now}; a control of 1 was {1.0 / gear:.6g} {position.partition(' in ')[2]}"
    return f"{now}; the control of the old one was of another kind"


def _keep_limits(drive: Element, model: Any, old: int) -> None:
    """Narrow the limits of a new drive, whose gear is 1, to those of the actuator that it replaces.

    The control of a torque drive is a torque [N m], that of a position drive an angle [rad].
    """
    gear, gain = float(model.actuator_gear[old, 0]), float(model.actuator_gainprm[old, 0])
    by_position = drive.get("input") == "pos"
    per_control = (1.0 / gear if gear else 0.0) if by_position else gear * gain
    control = int(model.actuator_ctrladr[old])
    limits = model.actuator_ctrlnum[old] and model.actuator_ctrllimited[control]
    if limits and _by_position(model, old) == by_position:
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
