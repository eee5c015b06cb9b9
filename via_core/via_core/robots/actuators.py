"""Actuators of MJCF joints as drives: gains, torque limit and delay at the joint, and remarks on what is not used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

# Members of these enumerations are not equal to the numbers in a model.
_ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED, _PID, _NONE, _AFFINE, _AT_ONCE, _INTEGRATES, _PID_STATE = (
    int(each)
    for each in (
        mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_PID, mujoco.mjtBias.mjBIAS_NONE,
        mujoco.mjtBias.mjBIAS_AFFINE, mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_INTEGRATOR,
        mujoco.mjtDyn.mjDYN_PID,
    )
)  # fmt: skip


@dataclass(frozen=True)
class Actuator:
    """An actuator of one joint, seen at the joint.

    An actuator of gear g has length g q and acts with g times its force. A position actuator has the force
    kp (ctrl - g q) - kv g qd, so kp and kd at the joint are g^2 kp and g^2 kv, and a command is g q. One with an
    integral has the same, and ki times the integral of ctrl - g q, which is limited; its command can change slowly.
    """

    name: str
    sort: Literal["position", "velocity", "torque", "other", "without input"]
    gear: float
    gain: float  # force per command
    damping: float  # [N m s/rad] in its force
    bias: float  # [N m] constant
    low: float  # [N m] limits of its force
    high: float
    delay: float  # [s]
    time_constant: float | None  # [s] of its activation; None: acts at once
    passive: tuple[float, float]  # damping [N m s/rad] and armature [kg m^2] that it adds to the joint
    polynomial: bool  # whether that damping is nonlinear
    integral: float = 0.0  # [N m/(rad s)] ki
    integral_limit: float | None = None  # [N m]
    slew: float | None = None  # [rad/s] of the goal


def actuators_of(model: Any, j: int) -> list[Actuator]:
    """The actuators of joint `j`. There can be more of them than controls, which are numbered on their own."""
    count = len(model.actuator_trntype)
    return [
        _actuator(model, i)
        for i in range(count)
        if int(model.actuator_trntype[i]) in _ON_JOINT and model.actuator_trnid[i, 0] == j
    ]


def elsewhere(model: Any) -> list[str]:
    """Names of the actuators that act on tendons, sites or bodies."""
    return [_name(model, i) for i, kind in enumerate(model.actuator_trntype) if int(kind) not in _ON_JOINT]


def _name(model: Any, i: int) -> str:
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) or f"actuator {i}"


def _actuator(model: Any, i: int) -> Actuator:
    gear, gain, bias = float(model.actuator_gear[i, 0]), float(model.actuator_gainprm[i, 0]), model.actuator_biasprm[i]
    affine = int(model.actuator_biastype[i]) in (_NONE, _AFFINE)
    pid = affine and int(model.actuator_gaintype[i]) == _PID and int(model.actuator_dyntype[i]) == _PID_STATE
    linear = pid or (affine and int(model.actuator_gaintype[i]) == _FIXED)
    constant, stiffness, damping = (
        map(float, bias[:3]) if linear and int(model.actuator_biastype[i]) == _AFFINE else (0.0, 0.0, 0.0)
    )
    integral, most, slew = 0.0, 0.0, 0.0
    if pid:
        integral, gain = gain * gear**2, -stiffness
        most, slew = map(float, model.actuator_dynprm[i, :2])
    integrates = int(model.actuator_dyntype[i]) == _INTEGRATES
    sort: Literal["position", "velocity", "torque", "other", "without input"] = "other"
    if not model.actuator_ctrlnum[i]:
        sort = "without input"
    elif linear and not integrates and gain > 0.0 and np.isclose(stiffness, -gain):
        sort = "position"
    elif linear and not integrates and stiffness == 0.0 and damping == 0.0:
        sort = "torque"
    elif linear and not integrates and gain > 0.0 and stiffness == 0.0 and np.isclose(damping, -gain):
        sort = "velocity"
    ends = np.array([-np.inf, np.inf])
    if model.actuator_forcelimited[i]:
        ends = model.actuator_forcerange[i]
    control = int(model.actuator_ctrladr[i])
    if sort == "torque" and model.actuator_ctrllimited[control]:
        commanded = np.sort(gain * model.actuator_ctrlrange[control]) + constant
        ends = np.array([max(ends[0], commanded[0]), min(ends[1], commanded[1])])
    low, high = np.sort(gear * ends) if gear else (0.0, 0.0)
    return Actuator(
        name=_name(model, i),
        sort=sort,
        gear=gear,
        gain=gain,
        damping=-damping * gear**2,
        bias=constant * gear,
        low=float(low),
        high=float(high),
        delay=float(model.actuator_delay[i]),
        time_constant=None if pid or int(model.actuator_dyntype[i]) == _AT_ONCE else float(model.actuator_dynprm[i, 0]),
        passive=(float(model.actuator_damping[i]) * gear**2, float(model.actuator_armature[i]) * gear**2),
        polynomial=bool(np.any(model.actuator_dampingpoly[i])),
        integral=integral,
        integral_limit=integral * most / abs(gear) if most else None,
        slew=slew / abs(gear) if slew else None,
    )


def drive_of(model: Any, j: int) -> dict[str, Any]:
    """Entries of RobotJoint for the drive of joint `j`; its damping and armature include those of the actuators."""
    found, remarks = actuators_of(model, j), []
    dof = int(model.jnt_dofadr[j])
    passive = np.array([each.passive for each in found]).reshape(-1, 2).sum(axis=0)
    made: dict[str, Any] = {"armature": float(model.dof_armature[dof] + passive[1])}
    positions = [each for each in found if each.sort == "position"]
    used = (positions or [each for each in found if each.sort == "torque"])[:1]
    limits = (-np.inf, np.inf)
    for each in (used or [each for each in found if each.sort != "without input"])[:1]:
        limits = each.low, each.high
    for each in used:
        made |= {"bias": each.bias, "delay": each.delay or None}
        if each.time_constant is not None:
            remarks.append(
                f"activation dynamics of actuator '{each.name}' (time constant {each.time_constant:g} s): not used"
            )
    if positions:
        speeds = [each for each in found if each.sort == "velocity"]
        used += speeds
        kp, kd = used[0].gain * used[0].gear ** 2, used[0].damping + sum(each.damping for each in speeds)
        outside = used[0].damping == 0.0  # its torque limit does not include the damping
        remarks += [
            f"velocity actuator '{each.name}' is part of the position drive, as kd: its goal is taken as 0"
            for each in speeds
        ]
        if kd == 0.0 and passive[0]:
            kd, passive[0] = float(passive[0]), 0.0  # as `via export` writes it
            remarks.append(f"damping of the actuators of {kd:.4g} N m s/rad is kd of the drive")
        elif kd == 0.0 and used[0].time_constant is None:
            remarks.append(f"position actuator '{used[0].name}' has no kv: kd is 0")
        made |= {"drive": "position", "kp": kp, "kd": kd, "gear": used[0].gear, "ki": used[0].integral}
        made |= {"integral_limit": used[0].integral_limit, "slew": used[0].slew}
        made["limited"] = "proportional" if outside and kd else "sum"
    elif used:
        made |= {"drive": "torque", "gear": used[0].gear * used[0].gain}
    if passive.any():
        remarks.append(
            f"its actuators add damping {passive[0]:.4g} N m s/rad and rotor inertia {passive[1]:.4g} kg m^2: included"
        )
    if any(each.polynomial for each in found):
        remarks.append("polynomial damping of its actuators: only the linear part is used")
    made["damping"] = float(model.dof_damping[dof] + passive[0])
    why = {
        "without input": "has no input",
        "other": "is neither a motor nor a position servo",
        "velocity": "controls a speed",
        "torque": "is a motor beside another drive",
        "position": "is a position servo beside another drive",
    }
    remarks += [f"actuator '{each.name}' {why[each.sort]}: not used" for each in found if each not in used]
    if model.jnt_actfrclimited[j]:
        low, high = model.jnt_actfrcrange[j]
        limits = max(limits[0], float(low)), min(limits[1], float(high))
    effort = max(map(abs, limits))
    made["effort"] = effort if np.isfinite(effort) and effort > 0.0 else None
    if made["effort"] and not np.isclose(-limits[0], limits[1]):
        remarks.append(
            f"its force range is {limits[0]:g} to {limits[1]:g}: a device file has one limit for both directions, and "
            f"the larger one is taken, {effort:g}"
        )
    return {**made, "remarks": tuple(remarks)}
