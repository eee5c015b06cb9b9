"""Damping in the transmission."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one, tenth_viscous

KIND = EffectKind(
    name="spring_damping",
    text="damping in the transmission, proportional to the rate of deflection",
    term="-coefficient dphi/dt",
    confused_with="viscous_friction: acts on both sides",
    sites=("transmission",),
    parameters=(
        EffectParameter(
            "coefficient", "N m s/rad", 0.0, 1e6, 0.0, "torque per rate of deflection", True, slot="spring_damping"
        ),
    ),
    slots=(Slot("spring_damping", "N m s/rad", "damping of the rate of deflection", 2),),
    starts=one(coefficient=tenth_viscous),
)
