"""Parameter file (JSON) of BAM, Better Actuator Models, by Rhoban.

    friction = friction_base + exp(-(|v|/dtheta_stribeck)^alpha) friction_stribeck
             + |load_friction_external C - load_friction_motor T| + ...

with motor torque T and external torque C, as in `load_dependent_friction` (docs/notation.md). The smallest of the
models m1 to m6 that holds all terms is written. kt [N m/A] and R [Ohm] follow from the torque limit kt V/R at supply
voltage V and the back EMF kt^2/R. Source: parameter files and model.py of github.com/Rhoban/bam; arXiv 2410.08650.
"""

from __future__ import annotations

import json
from math import isfinite

from via_sim.joint.parameters import LINK, POSITION_DRIVE, P

from via_export.target import Target
from via_export.xml import number

EXPONENT = 2.0  # of the Stribeck curve of via_sim


def write(target: Target, supply: float | None = None, given: dict[str, object] | None = None) -> str:
    """JSON of the parameters.

    supply  [V] of the drive; without it kt and R are left out
    given   a parameter file to update: its actuator, kt and R stay unless they are computed
    """
    row = target.row
    numbers: dict[str, object] = {**(given or {})}
    numbers.update(_electric(target, supply))
    axis = LINK
    load = {
        "motor": float(row[P.load_friction + axis]),
        "external": float(row[P.counter_friction + axis]),
        "motor_stribeck": float(row[P.load_stribeck + axis]),
        "external_stribeck": float(row[P.counter_stribeck + axis]),
    }
    quadratic = float(row[P.load_quadratic + axis])
    breakaway = sum(float(row[P.breakaway_friction + each]) + target.bristle(each)[0] for each in target.moving)
    kinetic = sum(float(row[P.kinetic_friction + each]) + target.bristle(each)[0] for each in target.moving)
    model = _model(load, quadratic, breakaway > kinetic)
    numbers |= {
        "armature": target.rigid_inertia,
        "q_offset": target.of_axis(P.encoder_offset, LINK),
        "command_delay": target.late,
        "friction_base": kinetic,
        "friction_viscous": target.rigid_viscous,
    }
    if model in ("m2", "m4", "m5", "m6"):
        speed = float(row[P.stribeck_velocity + axis if breakaway > kinetic else P.load_velocity + axis])
        numbers |= {"friction_stribeck": breakaway - kinetic, "dtheta_stribeck": speed, "alpha": EXPONENT}
    if model in ("m3", "m4"):
        numbers["load_friction_base"] = load["motor"]
        if model == "m4":
            numbers["load_friction_stribeck"] = load["motor_stribeck"]
    if model in ("m5", "m6"):
        numbers |= {f"load_friction_{name}": value for name, value in load.items()}
    if model == "m6":
        numbers |= {"load_friction_motor_quad": quadratic, "load_friction_external_quad": quadratic}
    numbers |= {"model": model, "actuator": numbers.get("actuator", target.device.name)}
    rounded = {name: float(number(value)) if isinstance(value, float) else value for name, value in numbers.items()}
    return json.dumps(rounded, indent=2) + "\n"


def _model(load: dict[str, float], quadratic: float, stribeck: bool) -> str:
    """The smallest model with all terms."""
    if quadratic > 0.0:
        return "m6"
    grows, at_rest = (
        load["motor"] > 0.0 or load["external"] > 0.0,
        load["motor_stribeck"] + load["external_stribeck"] > 0.0,
    )
    if not grows and not at_rest:
        return "m2" if stribeck else "m1"
    alike = load["motor"] == load["external"] and load["motor_stribeck"] == load["external_stribeck"]
    if alike:
        return "m4" if stribeck or at_rest else "m3"
    return "m5"


def _electric(target: Target, supply: float | None) -> dict[str, float]:
    """kt and R of a position drive; empty without its supply, torque limit or back EMF."""
    row = target.row
    damping = float(row[P.drive_damping])
    if supply is None or row[P.link_drive] != POSITION_DRIVE or not isfinite(target.effort) or damping <= 0.0:
        return {}
    kt = damping * supply / target.effort
    return {"kt": kt, "R": kt * kt / damping}
