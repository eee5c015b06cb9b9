"""The dead zone of a drive: the dead time of its transistors takes the same torque from every command."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one
from via_sim.catalogue.terms import Term


def _passed(dead_zone: float, torque: float) -> float:
    return torque - min(max(torque, -dead_zone), dead_zone)


KIND = EffectKind(
    name="dead_zone",
    text="a drive that takes the same torque from all that is commanded, or that a position drive computes, and passes "
    "none of a smaller one",
    term="u - width sign(u) for |u| > width, else 0",
    confused_with="coulomb_friction: has the sign of the speed; torque_deadband: large commands act in full",
    sites=("motor",),
    parameters=(EffectParameter("width", "N m", 0.0, 1e6, 0.0, "torque that is taken", slot="dead_zone"),),
    slots=(Slot("dead_zone", "N m", "torque that the drive takes from every command", 3),),
    terms=(Term("command", _passed),),
    starts=one(width=lambda here: 0.05 * here.peak),
    needs_torque_drive=True,
    of_drive=True,
)
