"""Actuator configuration of Isaac Lab as Python text, with names of Isaac Lab 2 (3.0 accepts the limits as aliases).

Friction: torque k v + b opposes the motion with `viscous_friction` k and `friction`, `dynamic_friction` b. From Isaac
Sim 5 on these are efforts; in 4.5 friction is a coefficient of the joint's load and dynamic friction has no effect.
Source: isaaclab.actuators, ActuatorBaseCfg, ImplicitActuatorCfg, IdealPDActuatorCfg, DelayedPDActuatorCfg.
"""

from __future__ import annotations

from math import isfinite

from via_sim.joint.parameters import LINK, POSITION_DRIVE, P

from via_export.target import Target
from via_export.xml import number

PHYSICS_STEP = 0.005  # [s] `sim.dt` for which the delay is counted


def write(target: Target, comment: str = "", joint: str = "") -> str:
    """Python text that defines the dictionary ACTUATORS for ArticulationCfg."""
    row, name = target.row, target.device.name
    steps = round(target.late / PHYSICS_STEP)
    kind = "DelayedPDActuatorCfg" if steps else "ImplicitActuatorCfg"
    explicit = kind != "ImplicitActuatorCfg"
    stiffness, damping = _gains(target)
    breakaway, kinetic = target.rigid_dry
    lines = [f"joint_names_expr=[{(joint or target.names[0])!r}],"]
    if isfinite(target.effort):
        lines.append(f"{'effort_limit' if explicit else 'effort_limit_sim'}={number(target.effort)},  # [N m]")
    if isfinite(target.speed):
        lines.append(f"{'velocity_limit' if explicit else 'velocity_limit_sim'}={number(target.speed)},  # [rad/s]")
    lines += [
        f"stiffness={number(stiffness)},  # [N m/rad]",
        f"damping={number(damping)},  # [N m s/rad] of the drive",
        f"armature={number(_armature(target))},  # [kg m^2]",
        f"friction={number(breakaway)},  # [N m] static",
        f"dynamic_friction={number(kinetic)},  # [N m]",
        f"viscous_friction={number(target.rigid_viscous)},  # [N m s/rad]",
    ]
    if steps:
        lines.append(f"min_delay={steps},  # physics steps of {PHYSICS_STEP} s: {number(target.late)} s")
        lines.append(f"max_delay={steps},")
    notes = "".join(f"# {line}\n" for line in comment.splitlines())
    if row[P.link_drive] != POSITION_DRIVE and stiffness == 0.0:
        notes += "# The drive is commanded by torque: use set_joint_effort_target.\n"
    body = "\n".join(f"        {line}" for line in lines)
    return (
        f'{notes}from isaaclab.actuators import {kind}\n\nACTUATORS = {{\n    "{name}": {kind}(\n{body}\n    ),\n}}\n'
    )


def _gains(target: Target) -> tuple[float, float]:
    """Stiffness [N m/rad] and damping [N m s/rad] of the drive; of a servo those of its bandwidth."""
    row = target.row
    if row[P.link_drive] == POSITION_DRIVE:
        return target.of_axis(P.torque_gain, LINK) * float(row[P.drive_stiffness]), float(row[P.drive_damping])
    if target.device.n_motors and target.is_servo(1):
        w = float(row[P.bandwidth])
        return target.inertia * w * w, 2.0 * target.inertia * w
    return 0.0, 0.0


def _armature(target: Target) -> float:
    """[kg m^2] that the USD file lacks: motors behind springs, and changes of the link's inertia."""
    return max(target.rigid_inertia - float(target.nominal[P.inertia + LINK]), 0.0)
