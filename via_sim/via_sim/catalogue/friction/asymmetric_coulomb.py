"""Dry friction that differs with the direction of motion."""

from __future__ import annotations

from via_sim.catalogue.friction.coulomb_friction import add_dry
from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import each, tenth


def _write(spot: Spot, value: Values) -> None:
    least = min(value["forward"], value["backward"]) - abs(spot["friction_asymmetry"])
    add_dry(spot, 0.5 * (value["forward"] + value["backward"]), least)
    spot["friction_asymmetry"] += 0.5 * (value["forward"] - value["backward"])


KIND = EffectKind(
    name="asymmetric_coulomb",
    text="dry friction that differs with the direction of motion",
    term="-forward for v > 0, +backward for v < 0",
    confused_with="torque_bias beside coulomb_friction: the two are equal",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter("forward", "N m", -1e6, 1e6, 0.0, "added while the angle increases", True),
        EffectParameter("backward", "N m", -1e6, 1e6, 0.0, "added while the angle decreases", True),
    ),
    slots=(Slot("friction_asymmetry", "N m", "half the difference of forward and backward dry friction", 3),),
    write=_write,
    starts=each(forward=tenth, backward=tenth),
    contains=("coulomb_friction", (0, 1)),
    adds=True,
    dry=True,
)
