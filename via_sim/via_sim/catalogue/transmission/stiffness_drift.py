"""A spring that changes during the run."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one

KIND = EffectKind(
    name="stiffness_drift",
    text="a spring that stiffens or softens during the run",
    term="(1 + rate t) tau_e(phi), t since the beginning of the run",
    confused_with="payload, wear: time",
    sites=("transmission",),
    parameters=(
        EffectParameter(
            "rate", "1/s", -1.0, 1.0, 0.0, "relative increase of the torque per time", True, slot="stiffness_rate"
        ),
    ),
    slots=(Slot("stiffness_rate", "1/s", "relative increase of torque per time", 2),),
    starts=one(rate=lambda here: 0.1 / here.duration),
)
