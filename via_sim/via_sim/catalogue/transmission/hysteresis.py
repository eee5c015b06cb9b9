"""A Maxwell element parallel to the spring."""

from __future__ import annotations

from via_sim.catalogue.friction.presliding_friction import SLIP
from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import sliding

KIND = EffectKind(
    name="hysteresis",
    text="a Maxwell element parallel to the spring: elastic until it slips",
    term="-F, dF = stiffness dphi within |F| <= torque",
    confused_with="spring_law, preset_error: loading against unloading; presliding_friction: acts on both sides",
    sites=("transmission",),
    parameters=(
        EffectParameter("torque", "N m", 0.0, 1e6, 0.0, "torque at which it slips", slot="hysteresis_torque"),
        EffectParameter(
            "stiffness", "N m/rad", 1e-2, 1e6, 1.0, "stiffness until it slips", slot="hysteresis_stiffness"
        ),
    ),
    slots=(
        Slot("hysteresis_torque", "N m", "at which the Maxwell element parallel to the spring slips", 2),
        Slot("hysteresis_stiffness", "N m/rad", "of the Maxwell element", 2, 1.0),
    ),
    starts=sliding(lambda here: [share * here.deflection for share in (0.05, 0.2, 0.8)]),
    forms=(SLIP,),
)
