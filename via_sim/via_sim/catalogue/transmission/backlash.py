"""A torque-free gap in the transmission."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one

KIND = EffectKind(
    name="backlash",
    text="a torque-free gap between motor and spring; `motor` is the number of the transmission",
    term="tau_e(0) for |phi| < gap/2, else tau_e(phi -+ gap/2)",
    confused_with="presliding_friction, spring_law: a torque-free gap of constant width, impact at its end",
    sites=("transmission",),
    parameters=(EffectParameter("gap", "rad", 0.0, 0.5, 0.0, "full width of the gap", slot="backlash"),),
    slots=(Slot("backlash", "rad", "width of the torque-free gap in the transmission", 2),),
    starts=one(gap=lambda here: 0.2 * here.deflection),
)
