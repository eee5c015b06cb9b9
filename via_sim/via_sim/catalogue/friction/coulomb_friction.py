"""Dry friction of constant magnitude."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import one, tenth


def _write(spot: Spot, value: Values) -> None:
    spot["breakaway_friction"] += value["torque"]
    spot["kinetic_friction"] += value["torque"]


KIND = EffectKind(
    name="coulomb_friction",
    text="dry friction of constant magnitude; the axis sticks while the torque on it is smaller",
    term="-torque s",
    confused_with="viscous_friction, quadratic_drag: several speeds",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(EffectParameter("torque", "N m", 0.0, 1e6, 0.0, "breakaway and kinetic friction", True),),
    write=_write,
    starts=one(torque=tenth),
    adds=True,
    dry=True,
)
