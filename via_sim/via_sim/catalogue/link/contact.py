"""A wall on one side of the link."""

from __future__ import annotations

from math import sqrt

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import Typical, grid

HARDER = (10.0, 100.0, 1000.0)  # times a wall that yields to the typical torque by half the typical motion
DAMPED = 0.3  # of the critical damping of the link on the wall


def _write(_spot: Spot, value: Values) -> None:
    if abs(value["side"]) != 1.0:
        raise ParameterError(f"side must be -1 or 1, got {value['side']}")


def _starts(here: Typical) -> list[dict[str, float]]:
    """Soft walls within the motion, hard ones near its ends: the joint rests against them, or touches them rarely.

    From hard ones it bounces, or it does not: a fit does not pass from one to the other.
    """
    soft = 2.0 * here.torque / here.angle
    least, low, tenth, ninetieth, high, most = (float(each) for each in here.range)
    soft_walls = ((ninetieth, 1.0), (high, 1.0), (tenth, -1.0), (low, -1.0))
    walls = [(soft, 0.0, *wall) for wall in soft_walls]
    for stiffness in (times * soft for times in HARDER):
        depth, critical = here.torque / stiffness, 2.0 * sqrt(stiffness * here.device.link.inertia)
        for wall in ((high, 1.0), (most - depth, 1.0), (low, -1.0), (least + depth, -1.0)):
            walls += [(stiffness, 0.0, *wall), (stiffness, DAMPED * critical, *wall)]
    return [dict(zip(("stiffness", "damping", "angle", "side"), wall, strict=True)) for wall in walls]


KIND = EffectKind(
    name="contact",
    text="a wall on one side of the link: a spring and a damper that never pull",
    term="-side max(stiffness depth + damping d(depth)/dt, 0), depth = side (q - angle) > 0",
    confused_with="spring_law: starts at one link angle",
    sites=("environment",),
    parameters=(
        EffectParameter("angle", "rad", -10.0, 10.0, 0.0, "of the wall", slot="contact_angle"),
        EffectParameter("stiffness", "N m/rad", 0.0, 1e6, 0.0, "of the wall", True, slot="contact_stiffness"),
        EffectParameter("damping", "N m s/rad", 0.0, 1e6, 0.0, "of the wall", True, slot="contact_damping"),
        EffectParameter(
            "side", "-", -1.0, 1.0, 1.0, "1: wall at larger angles, -1: at smaller ones", slot="contact_side"
        ),
    ),
    slots=(
        Slot("contact_stiffness", "N m/rad", "of a wall; 0: no wall"),
        Slot("contact_damping", "N m s/rad", "of the wall; it never pulls"),
        Slot("contact_angle", "rad", "of the wall"),
        Slot("contact_side", "-", "1: wall at larger angles, -1: at smaller ones", 1, 1.0),
    ),
    write=_write,
    starts=grid("stiffness", at=_starts),
    touched=True,
)
