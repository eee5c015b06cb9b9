"""Dry friction that falls with speed: Stribeck's curve."""

from __future__ import annotations

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import grid


def _write(spot: Spot, value: Values) -> None:
    if value["breakaway"] < value["kinetic"]:
        raise ParameterError(f"breakaway {value['breakaway']} N m must be >= kinetic {value['kinetic']} N m")
    spot["breakaway_friction"] += value["breakaway"]
    spot["kinetic_friction"] += value["kinetic"]


KIND = EffectKind(
    name="stribeck_friction",
    text="dry friction that falls from breakaway to kinetic as exp(-(v/velocity)^2)",
    term="-(kinetic + (breakaway - kinetic) exp(-(v/velocity)^2)) s",
    confused_with="coulomb_friction, presliding_friction: slow speeds, stick-slip",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(
        EffectParameter("breakaway", "N m", 0.0, 1e6, 0.0, "friction at standstill", True),
        EffectParameter("kinetic", "N m", 0.0, 1e6, 0.0, "friction at speed, at most breakaway", True),
        EffectParameter(
            "velocity", "rad/s", 1e-3, 1e2, 1.0, "speed at which 1/e of the difference is left",
            slot="stribeck_velocity",
        ),
    ),
    slots=(
        Slot("stribeck_velocity", "rad/s", "speed at which breakaway less kinetic has fallen to 1/e", 3, 1.0),
    ),
    write=_write,
    starts=grid("breakaway", "kinetic", at=lambda here: [
        {"breakaway": 0.2 * here.torque, "kinetic": 0.1 * here.torque, "velocity": share * here.speed}
        for share in (0.03, 0.12, 0.4)
    ]),
    contains=("coulomb_friction", (1,)),
    dry=True,
)  # fmt: skip
