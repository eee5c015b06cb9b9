"""An encoder with a coarser resolution than in the device file."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot

KIND = EffectKind(
    name="encoder_quantisation",
    text="an encoder with a coarser resolution than in the device file; `motor` 0 is the link encoder",
    term="measures quantum round(angle/quantum)",
    confused_with="noise: measurements are on a grid",
    sites=("sensor",),
    parameters=(
        EffectParameter(
            "quantum", "rad", 0.0, 0.5, 0.0, "resolution; no effect if finer than in the device file",
            slot="encoder_quantum",
        ),
    ),
    measured=True,
    slots=(Slot("encoder_quantum", "rad", "resolution of the measurement", 3),),
)  # fmt: skip
