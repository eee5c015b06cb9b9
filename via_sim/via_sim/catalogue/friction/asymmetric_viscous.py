"""Viscous friction that differs with the direction of motion."""

from __future__ import annotations

from via_sim.catalogue.friction.viscous_friction import add_viscous
from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import each, tenth_viscous


def _write(spot: Spot, value: Values) -> None:
    forward, backward = value["forward"], value["backward"]
    given = f"forward {forward} and backward {backward}"
    add_viscous(spot, 0.5 * (forward + backward), 0.5 * (forward - backward), given)


KIND = EffectKind(
    name="asymmetric_viscous",
    text="viscous friction that differs with the direction of motion",
    term="-forward v for v > 0, -backward v for v < 0",
    confused_with="torque_bias, quadratic_drag: the slope over |v|",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter("forward", "N m s/rad", -1e6, 1e6, 0.0, "added while the angle increases", True),
        EffectParameter("backward", "N m s/rad", -1e6, 1e6, 0.0, "added while the angle decreases", True),
    ),
    slots=(Slot("viscous_asymmetry", "N m s/rad", "half the difference of forward and backward friction", 3),),
    write=_write,
    starts=each(forward=tenth_viscous, backward=tenth_viscous),
    contains=("viscous_friction", (0, 1)),
)
