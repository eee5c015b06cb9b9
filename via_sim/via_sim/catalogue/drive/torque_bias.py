"""Constant torque of a drive, or offset of a torque sensor."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import one, tenth


def _write(spot: Spot, value: Values) -> None:
    spot["sensed_bias" if spot.site == "sensor" else "torque_bias"] = value["torque"]


KIND = EffectKind(
    name="torque_bias",
    text="a constant torque added to the command; at a sensor added to the measured torque",
    term="u + torque",
    confused_with="asymmetric_coulomb: a hold at standstill; preset_error: does not depend on stiffness",
    sites=("motor", "sensor"),
    parameters=(EffectParameter("torque", "N m", -1e6, 1e6, 0.0, "added torque", True),),
    slots=(
        Slot("torque_bias", "N m", "torque without a command: drive of a rigid joint, motor 1, motor 2", 3),
        Slot("sensed_bias", "N m", "added to the measured torque: link, motor 1, motor 2", 3),
    ),
    write=_write,
    starts=one(torque=tenth),
    needs_torque_drive=True,
    of_drive=True,
)
