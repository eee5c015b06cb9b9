"""MJCF files, compiled by MuJoCo (defaults, includes, units, inertia from geometry), as rigid bodies in pinocchio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio

from via_core.errors import DeviceError
from via_core.robots.models import Robot, RobotJoint

# Members of these enumerations are not equal to the numbers in a model.
_HINGE, _SLIDE, _BALL, _FREE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("HINGE", "SLIDE", "BALL", "FREE")
)
_ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED, _AFFINE, _AT_ONCE = (
    int(each) for each in (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE, mujoco.mjtDyn.mjDYN_NONE)
)


def read_mjcf(path: Path) -> Robot:
    """The robot of an MJCF file. Raises DeviceError in one line.

    If meshes or other assets are missing, geometry that needs them is left out with a remark.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise DeviceError(f"{path}: MuJoCo cannot read it: {_line(error)}") from None
    remarks: list[str] = []
    try:
        model = spec.compile()
    except ValueError as first:
        remarks += _drop_assets(spec, _line(first))
        try:
            model = spec.compile()
        except ValueError as error:
            hint = "; state <inertial> for bodies whose mass comes from missing meshes" if "mass" in str(error) else ""
            raise DeviceError(f"{path}: MuJoCo cannot compile it: {_line(error)}{hint}") from None
    joints = tuple(_joint(model, j) for j in range(model.njnt) if int(model.jnt_type[j]) in (_HINGE, _SLIDE))
    if model.neq:
        remarks.append(f"{model.neq} equality constraints: not used")
    if model.ntendon:
        remarks.append(f"{model.ntendon} tendons, with their stiffness, damping and friction: not used")
    return Robot(path.stem, str(path), _bodies(model), joints, tuple(remarks))


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
    drive = _drive(model, j)
    effort = drive.pop("effort")
    if model.jnt_actfrclimited[j]:
        effort = min(effort or np.inf, float(np.abs(model.jnt_actfrcrange[j]).max()))
    return RobotJoint(
        joint_name(model, j),
        "prismatic" if model.jnt_type[j] == _SLIDE else "revolute",
        low=float(low),
        high=float(high),
        effort=effort,
        damping=float(model.dof_damping[dof]),
        friction=float(model.dof_frictionloss[dof]),
        armature=float(model.dof_armature[dof]),
        reference=float(model.qpos0[model.jnt_qposadr[j]]),
        remarks=(*remarks, *drive.pop("remarks")),
        **drive,
    )


def _drive(model: Any, j: int) -> dict[str, Any]:
    """Torque limit and gains of the actuators of a joint, seen at the joint, and remarks on what is not used.

    An actuator of gear g has length g q and acts with g times its force. With the gains of a position actuator,
    force = kp (ctrl - g q) - kv g qd, so kp and kd at the joint are g^2 kp and g^2 kv, and a command is g q.
    """
    found: dict[str, Any] = {"effort": None, "remarks": []}
    ours = [
        i for i in range(model.nu)
        if int(model.actuator_trntype[i]) in _ON_JOINT
        and model.actuator_trnid[i, 0] == j
    ]  # fmt: skip
    if len(ours) > 1:
        found["remarks"].append(f"{len(ours)} actuators: only the first is used")
    for i in ours[:1]:
        gear = float(model.actuator_gear[i, 0])
        gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) or f"actuator {i}"
        if model.actuator_forcelimited[i]:
            found["effort"] = float(np.abs(model.actuator_forcerange[i]).max() * abs(gear))
        simple = model.actuator_gaintype[i] == _FIXED
        affine = model.actuator_biastype[i] == _AFFINE
        if simple and affine and gain[0] > 0.0 and np.isclose(bias[1], -gain[0]):
            found |= {"kp": float(gain[0] * gear**2), "kd": float(-bias[2] * gear**2), "gear": gear}
            if bias[2] == 0.0 and model.actuator_dyntype[i] == _AT_ONCE:
                found["remarks"].append(f"position actuator '{name}' has no kv: kd is 0")
        elif simple and not affine:
            found["gear"] = float(gear * gain[0])
            if found["effort"] is None and model.actuator_ctrllimited[i]:
                found["effort"] = float(np.abs(model.actuator_ctrlrange[i]).max() * abs(gear * gain[0]))
        else:
            found["remarks"].append(f"actuator '{name}' is neither a motor nor a position servo: not used")
        if model.actuator_dyntype[i] != _AT_ONCE:
            found["remarks"].append(
                f"activation dynamics of actuator '{name}' (time constant {model.actuator_dynprm[i, 0]:g} s): not used"
            )
        if hasattr(model, "actuator_delay") and model.actuator_delay[i] > 0.0:
            found["delay"] = float(model.actuator_delay[i])
    return found


def _bodies(model: Any) -> pinocchio.Model:
    """The bodies in pinocchio; hinges and slides count their angle from qpos0.

    A joint with anchor p in its body's frame moves the body about p: its frame lies at p, and the body at -p in it.
    """
    made = pinocchio.Model()
    made.gravity.linear = np.array(model.opt.gravity)
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
        placed[b] = carrier, at
    rotors = np.zeros(made.nv)
    for carrier, values in armature.items():
        rotors[made.joints[carrier].idx_v : made.joints[carrier].idx_v + len(values)] = values
    made.armature = rotors
    return made


def _rotation(quaternion: Any) -> Any:
    w, x, y, z = map(float, quaternion)
    return pinocchio.Quaternion(w, x, y, z).normalized().toRotationMatrix()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160]
