"""Dry friction of constant magnitude."""

from __future__ import annotations

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import one, tenth


def _write(spot: Spot, value: Values) -> None:
    left = spot["kinetic_friction"] + value["torque"]
    if left < 0.0:
        raise ParameterError(f"torque {value['torque']} leaves {left:.6g} N m of dry friction, must be >= 0")
    spot["breakaway_friction"] += value["torque"]
    spot["kinetic_friction"] += value["torque"]


KIND = EffectKind(
    name="coulomb_friction",
    text="dry friction of constant magnitude, beside that of the device file; the axis sticks while less torque acts",
    term="-torque s",
    confused_with="viscous_friction, quadratic_drag: several speeds",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(EffectParameter("torque", "N m", -1e6, 1e6, 0.0, "added to breakaway and kinetic friction", True),),
    write=_write,
    starts=one(torque=tenth),
    adds=True,
    dry=True,
)
