"""Friction effects of the catalogue, at a motor or at the link."""

from __future__ import annotations

from via_sim.effects.kinds import (
    EffectKind,
    EffectParameter,
    into_slot,
    write_asymmetric_coulomb,
    write_asymmetric_viscous,
    write_coulomb,
    write_load_friction,
    write_presliding,
    write_stribeck,
    write_viscous,
)
from via_sim.joint.parameters import P

_SITES = ("motor", "link")
_TORQUE = EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction", True)

FRICTION_KINDS = (
    EffectKind(
        "coulomb_friction",
        _SITES,
        "dry friction of constant magnitude; the axis sticks while the torque on it is smaller",
        "-torque s",
        "viscous_friction, quadratic_drag: several speeds",
        (_TORQUE,),
        write_coulomb,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "asymmetric_coulomb",
        _SITES,
        "dry friction that differs with the direction of motion",
        "-forward for v > 0, +backward for v < 0",
        "torque_bias: a hold at standstill; in motion the two cannot be distinguished",
        (
            EffectParameter("forward", "N m", 0.0, 1e3, 0.0, "friction while the angle increases", True),
            EffectParameter("backward", "N m", 0.0, 1e3, 0.0, "friction while the angle decreases", True),
        ),
        write_asymmetric_coulomb,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "stribeck_friction",
        _SITES,
        "dry friction that falls from breakaway to kinetic as exp(-(v/velocity)^2)",
        "-(kinetic + (breakaway - kinetic) exp(-(v/velocity)^2)) s",
        "coulomb_friction, presliding_friction: slow speeds, stick-slip",
        (
            EffectParameter("breakaway", "N m", 0.0, 1e3, 0.0, "friction at standstill", True),
            EffectParameter("kinetic", "N m", 0.0, 1e3, 0.0, "friction at speed, at most breakaway", True),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the difference is left"),
        ),
        write_stribeck,
        needs_torque_drive=True,
    ),
    EffectKind(
        "viscous_friction",
        _SITES,
        "error of the viscous friction coefficient of the device file",
        "-coefficient v",
        "coulomb_friction: several speeds",
        (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device value", True),),
        write_viscous,
        needs_torque_drive=True,
        adds=True,
    ),
    EffectKind(
        "asymmetric_viscous",
        _SITES,
        "viscous friction that differs with the direction of motion",
        "-forward v for v > 0, -backward v for v < 0",
        "torque_bias, quadratic_drag: the slope over |v|",
        (
            EffectParameter("forward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle increases", True),
            EffectParameter("backward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle decreases", True),
        ),
        write_asymmetric_viscous,
        needs_torque_drive=True,
    ),
    EffectKind(
        "quadratic_drag",
        _SITES,
        "drag proportional to the squared speed",
        "-coefficient v |v|",
        "viscous_friction: several speeds",
        (EffectParameter("coefficient", "N m s^2/rad^2", 0.0, 1e2, 0.0, "torque at 1 rad/s", True),),
        into_slot(P.quadratic_drag, "coefficient"),
        needs_torque_drive=True,
    ),
    EffectKind(
        "presliding_friction",
        _SITES,
        "Dahl's bristle: friction that builds up with the travel since the last reversal, elastic at first",
        "-F, dF/dx = stiffness (1 - F s/torque)",
        "backlash, spring_law: micro-reversals, width of the loop over its amplitude",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "friction when sliding"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1e2, "stiffness of the bristle at rest"),
        ),
        write_presliding,
        needs_torque_drive=True,
    ),
    EffectKind(
        "load_dependent_friction",
        _SITES,
        "dry friction that increases with the load T of an axis (torque of its transmissions; in a rigid joint of its "
        "drive) and with the counter torque C from the other side (of a motor its drive; of a link gravity, walls and "
        "external torque); opposed torques press the teeth of a gear together",
        "-(|coefficient T - counter_coefficient C| + exp(-(v/velocity)^2) (|stribeck T - counter_stribeck C| + "
        "quadratic min(|T|, |C|)^2 where T C < 0)) s",
        "coulomb_friction: the same speeds under another load; torque_gain: reversals",
        (EffectParameter("coefficient", "-", 0.0, 1.0, 0.0, "friction per load, at any speed", True),),
        write_load_friction,
        needs_torque_drive=True,
        optional=(
            EffectParameter("counter_coefficient", "-", 0.0, 1.0, 0.0, "friction per counter torque, at any speed"),
            EffectParameter("stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per load"),
            EffectParameter("counter_stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per counter torque"),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the increase is left"),
            EffectParameter("quadratic", "1/(N m)", 0.0, 10.0, 0.0, "increase per square of the smaller torque", True),
        ),
    ),
)
