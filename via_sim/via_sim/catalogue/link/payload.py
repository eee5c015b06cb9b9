"""A mass on the link."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Form, Spot, Values
from via_sim.catalogue.starts import Start, Starts, Typical


def _write(spot: Spot, value: Values) -> None:
    spot["inertia"] += value["mass"] * value["distance"] ** 2
    spot["gravity_torque"] += value["mass"] * spot["gravity"] * value["distance"]


def _starts(here: Typical) -> list[Start]:
    """Directions with little and with much inertia for their weight: a rotor behind a gear hides that of the link."""
    link = here.device.link
    if link.gravity_torque == 0.0:
        return [Start(({"mass": 5.0 * link.inertia, "distance": 0.2},), ("mass",))]
    length = min(max(9.81 * link.inertia / abs(link.gravity_torque), 0.02), 1.0)  # [m] of a simple pendulum
    near, far = length / 8.0, 2.0 * length
    weighs = {"mass": 0.2 * link.inertia / (length * near), "distance": near}
    turns = {"mass": 0.2 * link.inertia / far**2, "distance": far}
    return [Start((weighs, turns), ("mass",))]


_BOTH = ("mass", "distance")
KIND = EffectKind(
    name="payload",
    text="a mass on the link, aligned with its gravity; without gravity (upright axis) only inertia increases",
    term="M + m l^2, gravity_torque + m g l",
    confused_with="link_inertia, gravity_error: both change together",
    sites=("link",),
    parameters=(
        EffectParameter("mass", "kg", 0.0, 1e3, 0.0, "m"),
        EffectParameter("distance", "m", 0.0, 10.0, 0.0, "l, from the axis"),
    ),
    write=_write,
    starts=Starts(("mass",), _starts),
    lever=True,
    forms=(
        Form("mass * distance", "kg m", _BOTH, lambda m, d: m * d, lambda m, d: (d, m)),
        Form("mass * distance^2", "kg m^2", _BOTH, lambda m, d: m * d**2, lambda m, d: (d**2, 2.0 * m * d)),
    ),
)
