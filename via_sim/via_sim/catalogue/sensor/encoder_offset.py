"""An offset of an encoder."""

from __future__ import annotations

from math import pi

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import grid

OFF = (0.01, 0.1)  # [rad] starts: the first has an influence through springs, the second through gravity
KIND = EffectKind(
    name="encoder_offset",
    text="an offset of an encoder; `motor` 0 is the link encoder",
    term="measures angle + offset",
    confused_with="preset_error, gravity_error: the other equations that use the angle",
    sites=("sensor",),
    parameters=(EffectParameter("offset", "rad", -pi, pi, 0.0, "added to the angle", slot="encoder_offset"),),
    slots=(Slot("encoder_offset", "rad", "added to the measurement: link, motor 1, motor 2", 3),),
    starts=grid("offset", at=lambda _here: [{"offset": offset} for offset in OFF]),
)
