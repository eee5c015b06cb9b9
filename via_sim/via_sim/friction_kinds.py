"""The kinds of friction in the catalogue: of a motor or of the link."""

from __future__ import annotations

from via_sim.effect_kinds import (
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
from via_sim.parameters import P

_SITES = ("motor", "link")
_TORQUE = EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction", True)

FRICTION_KINDS = (
    EffectKind(
        "coulomb_friction",
        _SITES,
        "dry friction of constant size; the axis sticks while the torque on it stays below",
        "-torque s",
        "viscous_friction, quadratic_drag: a ladder of speeds",
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
        "torque_bias: only a hold at standstill; on moving data name both",
        (
            EffectParameter("forward", "N m", 0.0, 1e3, 0.0, "friction while the angle grows", True),
            EffectParameter("backward", "N m", 0.0, 1e3, 0.0, "friction while it falls", True),
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
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed that leaves 1/e of the difference"),
        ),
        write_stribeck,
        needs_torque_drive=True,
    ),
    EffectKind(
        "viscous_friction",
        _SITES,
        "error of the viscous friction: what the device file forgot (or has too much)",
        "-coefficient v",
        "coulomb_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device's coefficient", True),),
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
            EffectParameter("forward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle grows", True),
            EffectParameter("backward", "N m s/rad", -1e2, 1e2, 0.0, "added while it falls", True),
        ),
        write_asymmetric_viscous,
        needs_torque_drive=True,
    ),
    EffectKind(
        "quadratic_drag",
        _SITES,
        "drag that grows with the square of the speed",
        "-coefficient v |v|",
        "viscous_friction: a ladder of speeds",
        (EffectParameter("coefficient", "N m s^2/rad^2", 0.0, 1e2, 0.0, "torque at 1 rad/s", True),),
        into_slot(P.quadratic_drag, "coefficient"),
        needs_torque_drive=True,
    ),
    EffectKind(
        "presliding_friction",
        _SITES,
        "Dahl's bristle: friction that builds up over the way since the last reversal, elastic at first",
        "-F, dF/dx = stiffness (1 - F s/torque)",
        "backlash, spring_law: micro-reversals, width of the loop over its amplitude",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "friction once it slides"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1e2, "of the bristle at rest"),
        ),
        write_presliding,
        needs_torque_drive=True,
    ),
    EffectKind(
        "load_dependent_friction",
        _SITES,
        "dry friction that grows with the load T of an axis, the torque of its transmissions (of a rigid joint of its "
        "drive), and with the counter torque C from the other side (of a motor its drive, of a link gravity, walls and "
        "external torque); both press the teeth of a gear together where they oppose one another",
        "-(|coefficient T - counter_coefficient C| + exp(-(v/velocity)^2) (|stribeck T - counter_stribeck C| + "
        "quadratic min(|T|, |C|)^2 where T C < 0)) s",
        "coulomb_friction: the same speeds under another load; torque_gain: reversals",
        (EffectParameter("coefficient", "-", 0.0, 1.0, 0.0, "friction per load, at any speed", True),),
        write_load_friction,
        needs_torque_drive=True,
        optional=(
            EffectParameter("counter_coefficient", "-", 0.0, 1.0, 0.0, "friction per counter torque, at any speed"),
            EffectParameter("stribeck", "-", 0.0, 1.0, 0.0, "what standstill adds per load"),
            EffectParameter("counter_stribeck", "-", 0.0, 1.0, 0.0, "what standstill adds per counter torque"),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed that leaves 1/e of what standstill adds"),
            EffectParameter("quadratic", "1/(N m)", 0.0, 10.0, 0.0, "added per square of the smaller torque", True),
        ),
    ),
)
