"""A spring between link and base: cables and hoses, a rubber seal, a spring that balances the weight."""

from __future__ import annotations

from math import pi

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import Typical, grid
from via_sim.catalogue.terms import Term


def _torque(link_spring: float, link_spring_rest: float, angle: float) -> float:
    return link_spring * (link_spring_rest - angle)


def _starts(here: Typical) -> list[dict[str, float]]:
    _, low, _, _, high, _ = (float(each) for each in here.range)
    return [{"stiffness": 0.1 * here.torque / here.angle, "rest": rest} for rest in (low, 0.5 * (low + high), high)]


KIND = EffectKind(
    name="link_spring",
    text="a spring between link and base, such as cables and hoses",
    term="-stiffness (q - rest)",
    confused_with="gravity_error: a larger range of angles; payload: changes inertia as well",
    sites=("link",),
    parameters=(
        EffectParameter("stiffness", "N m/rad", 0.0, 1e6, 0.0, "of the spring", True, slot="link_spring"),
        EffectParameter("rest", "rad", -4.0 * pi, 4.0 * pi, 0.0, "angle without torque", slot="link_spring_rest"),
    ),
    slots=(
        Slot("link_spring", "N m/rad", "of a spring to the base", 3),
        Slot("link_spring_rest", "rad", "angle at which it gives no torque", 3),
    ),
    terms=(Term("axis", _torque),),
    starts=grid("stiffness", at=_starts),
)
