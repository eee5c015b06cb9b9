"""Offset of the angle that pretensions the spring."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one

KIND = EffectKind(
    name="preset_error",
    text="offset of the angle that pretensions the spring, of the preset motor in a serial joint, else of its own",
    term="tau_e(phi - offset); serial: tau_e(phi, preset + offset)",
    confused_with="encoder_offset, spring_law: other presets",
    sites=("transmission",),
    parameters=(EffectParameter("offset", "rad", -1.0, 1.0, 0.0, "added to the angle", slot="pretension_offset"),),
    slots=(Slot("pretension_offset", "rad", "added to the motor angle that pretensions the spring", 2),),
    starts=one(offset=lambda here: 0.1 * here.deflection),
    of_preset=True,
)
