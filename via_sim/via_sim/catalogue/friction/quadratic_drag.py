"""Drag proportional to the squared speed."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one
from via_sim.catalogue.terms import Term


def _torque(quadratic_drag: float, speed: float) -> float:
    return -quadratic_drag * speed * abs(speed)


KIND = EffectKind(
    name="quadratic_drag",
    text="drag proportional to the squared speed",
    term="-coefficient v |v|",
    confused_with="viscous_friction: several speeds",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter(
            "coefficient", "N m s^2/rad^2", 0.0, 1e6, 0.0, "torque at 1 rad/s", True, slot="quadratic_drag"
        ),
    ),
    slots=(Slot("quadratic_drag", "N m s^2/rad^2", "times v |v|", 3),),
    terms=(Term("axis", _torque),),
    starts=one(coefficient=lambda here: 0.1 * here.torque / here.speed**2),
)
