"""Friction effects of the catalogue, at a motor or at the link."""

from __future__ import annotations

from functools import partial

from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.effects.kinds import EffectKind, EffectParameter, Values
from via_sim.joint.parameters import P

_kind = partial(EffectKind, sites=("motor", "link"), needs_torque_drive=True)


def _coulomb(row: Array, axis: int, _site: str, value: Values) -> None:
    row[P.breakaway_friction + axis] += value["torque"]
    row[P.kinetic_friction + axis] += value["torque"]


def _asymmetric_coulomb(row: Array, axis: int, site: str, value: Values) -> None:
    _coulomb(row, axis, site, {"torque": 0.5 * (value["forward"] + value["backward"])})
    row[P.friction_asymmetry + axis] += 0.5 * (value["forward"] - value["backward"])


def _stribeck(row: Array, axis: int, _site: str, value: Values) -> None:
    if value["breakaway"] < value["kinetic"]:
        raise ParameterError(f"breakaway {value['breakaway']} N m must be >= kinetic {value['kinetic']} N m")
    row[P.breakaway_friction + axis] += value["breakaway"]
    row[P.kinetic_friction + axis] += value["kinetic"]
    row[P.stribeck_velocity + axis] = value["velocity"]


def _viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    _more_viscous(row, axis, value["coefficient"], 0.0, f"coefficient {value['coefficient']}")


def _asymmetric_viscous(row: Array, axis: int, _site: str, value: Values) -> None:
    forward, backward = value["forward"], value["backward"]
    given = f"forward {forward} and backward {backward}"
    _more_viscous(row, axis, 0.5 * (forward + backward), 0.5 * (forward - backward), given)


def _more_viscous(row: Array, axis: int, mean: float, half: float, given: str) -> None:
    total, skewed = row[P.viscous_friction + axis] + mean, row[P.viscous_asymmetry + axis] + half
    if total - abs(skewed) < 0.0:
        raise ParameterError(f"{given} leaves {total - abs(skewed):.6g} N m s/rad of viscous friction, must be >= 0")
    row[P.viscous_friction + axis], row[P.viscous_asymmetry + axis] = total, skewed


def _both_sides(row: Array, axis: int, _site: str, value: Values) -> None:
    """Mark friction that depends on more than the load, see joint/friction.py."""
    more = ("counter_coefficient", "stribeck", "counter_stribeck", "quadratic")
    if any(value.get(name, 0.0) != 0.0 for name in more):
        row[P.both_sides + axis] = 1.0


FRICTION_KINDS = (
    _kind(
        "coulomb_friction",
        "dry friction of constant magnitude; the axis sticks while the torque on it is smaller",
        "-torque s",
        "viscous_friction, quadratic_drag: several speeds",
        (EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "breakaway and kinetic friction", True),),
        before=_coulomb,
        adds=True,
    ),
    _kind(
        "asymmetric_coulomb",
        "dry friction that differs with the direction of motion",
        "-forward for v > 0, +backward for v < 0",
        "torque_bias: a hold at standstill; in motion the two cannot be distinguished",
        (
            EffectParameter("forward", "N m", 0.0, 1e3, 0.0, "friction while the angle increases", True),
            EffectParameter("backward", "N m", 0.0, 1e3, 0.0, "friction while the angle decreases", True),
        ),
        before=_asymmetric_coulomb,
        adds=True,
    ),
    _kind(
        "stribeck_friction",
        "dry friction that falls from breakaway to kinetic as exp(-(v/velocity)^2)",
        "-(kinetic + (breakaway - kinetic) exp(-(v/velocity)^2)) s",
        "coulomb_friction, presliding_friction: slow speeds, stick-slip",
        (
            EffectParameter("breakaway", "N m", 0.0, 1e3, 0.0, "friction at standstill", True),
            EffectParameter("kinetic", "N m", 0.0, 1e3, 0.0, "friction at speed, at most breakaway", True),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the difference is left"),
        ),
        before=_stribeck,
    ),
    _kind(
        "viscous_friction",
        "error of the viscous friction coefficient of the device file",
        "-coefficient v",
        "coulomb_friction: several speeds",
        (EffectParameter("coefficient", "N m s/rad", -1e2, 1e2, 0.0, "added to the device value", True),),
        before=_viscous,
        adds=True,
    ),
    _kind(
        "asymmetric_viscous",
        "viscous friction that differs with the direction of motion",
        "-forward v for v > 0, -backward v for v < 0",
        "torque_bias, quadratic_drag: the slope over |v|",
        (
            EffectParameter("forward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle increases", True),
            EffectParameter("backward", "N m s/rad", -1e2, 1e2, 0.0, "added while the angle decreases", True),
        ),
        before=_asymmetric_viscous,
    ),
    _kind(
        "quadratic_drag",
        "drag proportional to the squared speed",
        "-coefficient v |v|",
        "viscous_friction: several speeds",
        (EffectParameter("coefficient", "N m s^2/rad^2", 0.0, 1e2, 0.0, "torque at 1 rad/s", True),),
        slots=(P.quadratic_drag,),
    ),
    _kind(
        "presliding_friction",
        "Dahl's bristle: friction that builds up with the travel since the last reversal, elastic at first",
        "-F, dF/dx = stiffness (1 - F s/torque)",
        "backlash, spring_law: micro-reversals, width of the loop over its amplitude",
        (
            EffectParameter("torque", "N m", 0.0, 1e3, 0.0, "friction when sliding"),
            EffectParameter("stiffness", "N m/rad", 1e-2, 1e6, 1e2, "stiffness of the bristle at rest"),
        ),
        slots=(P.bristle_torque, P.bristle_stiffness),
    ),
    _kind(
        "load_dependent_friction",
        "dry friction that increases with the load T of an axis (torque of its transmissions; in a rigid joint of its "
        "drive) and with the counter torque C from the other side (of a motor its drive; of a link gravity, walls and "
        "external torque); opposed torques press the teeth of a gear together",
        "-(|coefficient T - counter_coefficient C| + exp(-(v/velocity)^2) (|stribeck T - counter_stribeck C| + "
        "quadratic min(|T|, |C|)^2 where T C < 0)) s",
        "coulomb_friction: the same speeds under another load; torque_gain: reversals",
        (EffectParameter("coefficient", "-", 0.0, 1.0, 0.0, "friction per load, at any speed", True),),
        slots=(
            P.load_friction,
            P.counter_friction,
            P.load_stribeck,
            P.counter_stribeck,
            P.load_velocity,
            P.load_quadratic,
        ),
        before=_both_sides,
        optional=(
            EffectParameter("counter_coefficient", "-", 0.0, 1.0, 0.0, "friction per counter torque, at any speed"),
            EffectParameter("stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per load"),
            EffectParameter("counter_stribeck", "-", 0.0, 1.0, 0.0, "increase at standstill per counter torque"),
            EffectParameter("velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the increase is left"),
            EffectParameter("quadratic", "1/(N m)", 0.0, 10.0, 0.0, "increase per square of the smaller torque", True),
        ),
    ),
)
