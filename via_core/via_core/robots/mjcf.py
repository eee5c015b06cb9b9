"""MJCF files, compiled by MuJoCo (defaults, includes, units, inertia from geometry), as rigid bodies in pinocchio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio

from via_core.errors import DeviceError, one_line
from via_core.robots.actuators import drive_of, elsewhere
from via_core.robots.models import Robot, RobotJoint

# Members of these enumerations are not equal to the numbers in a model.
_HINGE, _SLIDE, _BALL, _FREE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("HINGE", "SLIDE", "BALL", "FREE")
)


def read_mjcf(path: Path) -> Robot:
    """The robot of an MJCF file. Raises DeviceError in one line.

    If meshes or other assets are missing, geometry that needs them is left out with a remark.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise DeviceError(f"{path}: MuJoCo cannot read it: {one_line(error)}") from None
    remarks: list[str] = []
    try:
        model = spec.compile()
    except ValueError as first:
        remarks += _drop_assets(spec, one_line(first))
        try:
            model = spec.compile()
        except ValueError as error:
            hint = "; state <inertial> for bodies whose mass comes from missing meshes" if "mass" in str(error) else ""
            raise DeviceError(f"{path}: MuJoCo cannot compile it: {one_line(error)}{hint}") from None
    joints = tuple(_joint(model, j) for j in range(model.njnt) if int(model.jnt_type[j]) in (_HINGE, _SLIDE))
    if model.neq:
        remarks.append(f"{model.neq} equality constraints: not used")
    if model.ntendon:
        remarks.append(f"{model.ntendon} tendons, with their stiffness, damping and friction: not used")
    bodies, lift = _bodies(model)
    rotors = bodies.armature.copy()
    for each in joints:
        rotors[bodies.joints[bodies.getJointId(each.name)].idx_v] = each.armature  # of its actuators as well
    bodies.armature = rotors
    return Robot(path.stem, str(path), bodies, joints, (*remarks, *_not_used(model)), lift)


def _not_used(model: Any) -> list[str]:
    """Remarks on what acts on the bodies and has no place in a device file."""
    remarks = []
    fixed = [joint_name(model, j) for j in range(model.njnt) if int(model.jnt_type[j]) in (_BALL, _FREE)]
    if fixed:
        remarks.append(f"joints {', '.join(fixed)} are free or ball joints: taken as fixed")
    if others := elsewhere(model):
        remarks.append(f"actuators {', '.join(others)} act on tendons, sites or bodies: not used")
    if model.opt.density or model.opt.viscosity:
        remarks.append(f"fluid of density {model.opt.density:g} and viscosity {model.opt.viscosity:g}: not used")
    flags = {
        "spring": "mjDSBL_SPRING", "damper": "mjDSBL_DAMPER", "frictionloss": "mjDSBL_FRICTIONLOSS",
        "actuation": "mjDSBL_ACTUATION",
    }  # fmt: skip
    if off := [name for name, bit in flags.items() if _disabled(model, bit)]:
        remarks.append(f"<flag> disables {', '.join(off)}: not used, the numbers are those of the enabled model")
    return remarks


def _disabled(model: Any, bit: str) -> bool:
    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, bit)))


def _drop_assets(spec: Any, reason: str) -> list[str]:
    """Remove geometry that needs files; a body without inertial then has the mass of its other geometry."""
    lost = []
    for geom in list(spec.geoms):
        if geom.meshname or geom.hfieldname:
            if not geom.parent.explicitinertial:
                lost.append(geom.parent.name or "a body without name")
            spec.delete(geom)
    for assets in (spec.skins, spec.materials, spec.textures, spec.meshes, spec.hfields):
        for asset in list(assets):
            spec.delete(asset)
    for geom in spec.geoms:
        geom.material = ""
    for site in spec.sites:
        site.material = ""
    remarks = [f"assets are left out, because not all could be read ({reason})"]
    if lost:
        remarks.append(f"the mass of meshes is missing in {', '.join(dict.fromkeys(lost))}: state <inertial> there")
    return remarks


def joint_name(model: Any, j: int) -> str:
    """Name of joint `j`; joints without a name are numbered."""
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}"


def _joint(model: Any, j: int) -> RobotJoint:
    dof = int(model.jnt_dofadr[j])
    low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    remarks = []
    if model.jnt_stiffness[j]:
        at = float(model.qpos_spring[model.jnt_qposadr[j]])
        remarks.append(
            f"stiffness {model.jnt_stiffness[j]:g} about {at:g}: not used, the device file of a rigid joint has no "
            "spring to the base; an effects file can have one, link_spring"
        )
    if np.any(model.dof_dampingpoly[dof]) or np.any(model.jnt_stiffnesspoly[j]):
        remarks.append("polynomial damping or stiffness: only the linear part is used")
    drive = drive_of(model, j)
    if model.jnt_actgravcomp[j] and np.any(model.body_gravcomp):
        remarks.append("its actuator's torque contains the compensation of gravity, which is not part of its command")
    return RobotJoint(
        joint_name(model, j),
        "prismatic" if model.jnt_type[j] == _SLIDE else "revolute",
        low=float(low),
        high=float(high),
        friction=float(model.dof_frictionloss[dof]),
        reference=float(model.qpos0[model.jnt_qposadr[j]]),
        stiffness=float(model.jnt_stiffness[j]),
        remarks=(*remarks, *drive.pop("remarks")),
        **drive,
    )


def _bodies(model: Any) -> tuple[pinocchio.Model, pinocchio.Model | None]:
    """The bodies in pinocchio, and the masses whose weight `gravcomp` compensates; angles are counted from qpos0.

    A joint with anchor p in its body's frame moves the body about p: its frame lies at p, and the body at -p in it.
    """
    made = pinocchio.Model()
    made.gravity.linear = np.zeros(3) if _disabled(model, "mjDSBL_GRAVITY") else np.array(model.opt.gravity)
    lifted = []
    placed = {0: (0, pinocchio.SE3.Identity())}  # body -> joint that carries it, and its placement there
    armature: dict[int, Any] = {}
    for b in range(1, model.nbody):
        carrier, at = placed[int(model.body_parentid[b])]
        at = at * pinocchio.SE3(_rotation(model.body_quat[b]), np.array(model.body_pos[b]))
        first = int(model.body_jntadr[b])
        for j in range(first, first + int(model.body_jntnum[b])):
            anchor = pinocchio.SE3(np.eye(3), np.array(model.jnt_pos[j]))
            if model.jnt_type[j] == _FREE:
                kind, place, at = pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), pinocchio.SE3.Identity()
            elif model.jnt_type[j] == _BALL:
                kind, place, at = pinocchio.JointModelSpherical(), at * anchor, anchor.inverse()
            else:
                of = (
                    pinocchio.JointModelRevoluteUnaligned
                    if model.jnt_type[j] == _HINGE
                    else pinocchio.JointModelPrismaticUnaligned
                )
                kind, place, at = of(np.array(model.jnt_axis[j])), at * anchor, anchor.inverse()
            carrier = made.addJoint(carrier, kind, place, joint_name(model, j))
            dof = int(model.jnt_dofadr[j])
            armature[carrier] = model.dof_armature[dof : dof + made.joints[carrier].nv]
        rotation = _rotation(model.body_iquat[b])
        tensor = rotation @ np.diag(model.body_inertia[b]) @ rotation.T
        made.appendBodyToJoint(
            carrier, pinocchio.Inertia(float(model.body_mass[b]), np.array(model.body_ipos[b]), tensor), at
        )
        if model.body_gravcomp[b]:
            mass = float(model.body_mass[b] * model.body_gravcomp[b])
            lifted.append((carrier, pinocchio.Inertia(mass, np.array(model.body_ipos[b]), np.zeros((3, 3))), at))
        placed[b] = carrier, at
    rotors = np.zeros(made.nv)
    for carrier, values in armature.items():
        rotors[made.joints[carrier].idx_v : made.joints[carrier].idx_v + len(values)] = values
    made.armature = rotors
    if not lifted:
        return made, None
    lift = made.copy()
    for k in range(lift.njoints):
        lift.inertias[k] = pinocchio.Inertia.Zero()
    for each in lifted:
        lift.appendBodyToJoint(*each)
    return made, lift


def _rotation(quaternion: Any) -> Any:
    w, x, y, z = map(float, quaternion)
    return pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix()
