"""Largest speed of the goal of a position drive."""

from __future__ import annotations

from via_sim.catalogue.kinds import NEVER, EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import limits


def _write(spot: Spot, value: Values) -> None:
    if value["limit"] < NEVER:
        spot["drive_speed_limit"] = min(spot["drive_speed_limit"], value["limit"])


KIND = EffectKind(
    name="speed_limit",
    text="largest speed at which the goal of a position drive follows the commanded angle; of this and the limit in "
    "the device file the lower one acts",
    term="|dg/dt| <= limit, g the acting goal",
    confused_with="torque_saturation, actuator_lag: the same steps against another load, and smaller steps",
    sites=("command",),
    parameters=(EffectParameter("limit", "rad/s", 1e-3, NEVER, NEVER, "largest speed of the goal"),),
    write=_write,
    starts=limits(lambda here: [share * here.slew for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.2)]),
    of_goal=True,
)
