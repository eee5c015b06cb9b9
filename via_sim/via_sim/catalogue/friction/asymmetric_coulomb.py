"""Dry friction that differs with the direction of motion.

It is the same as a symmetric one beside a constant torque, such as that of a tilted base or of a torque sensor's zero;
the report states the sizes of both.
"""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Form, Slot, Spot, Values
from via_sim.catalogue.starts import each, tenth


def _write(spot: Spot, value: Values) -> None:
    mean = 0.5 * (value["forward"] + value["backward"])
    spot["breakaway_friction"] += mean
    spot["kinetic_friction"] += mean
    spot["friction_asymmetry"] += 0.5 * (value["forward"] - value["backward"])


_BOTH = ("forward", "backward")
KIND = EffectKind(
    name="asymmetric_coulomb",
    text="dry friction that differs with the direction of motion",
    term="-forward for v > 0, +backward for v < 0",
    confused_with="torque_bias beside coulomb_friction: the two are equal",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter("forward", "N m", 0.0, 1e6, 0.0, "friction while the angle increases", True),
        EffectParameter("backward", "N m", 0.0, 1e6, 0.0, "friction while the angle decreases", True),
    ),
    slots=(Slot("friction_asymmetry", "N m", "half the difference of forward and backward dry friction", 3),),
    write=_write,
    starts=each(forward=tenth, backward=tenth),
    contains=("coulomb_friction", (0, 1)),
    forms=(
        Form(
            "equal to Coulomb friction of", "N m", _BOTH,
            lambda f, b: 0.5 * (f + b), lambda _f, _b: (0.5, 0.5),
        ),
        Form(
            "beside a constant torque of", "N m", _BOTH,
            lambda f, b: 0.5 * (b - f), lambda _f, _b: (-0.5, 0.5),
        ),
    ),
    adds=True,
    dry=True,
)  # fmt: skip
