"""An angle that is stamped late."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import grid

MAX_SKEW = 0.05  # [s] largest delay of an encoder
KIND = EffectKind(
    name="channel_skew",
    text="one angle is stamped later than the other channels; `motor` 0 is the link",
    term="measures angle(t - delay)",
    confused_with="actuator_delay, viscous_friction: other equations with that angle; response of the drive",
    sites=("timing",),
    parameters=(EffectParameter("delay", "s", 0.0, MAX_SKEW, 0.0, "delay of the stamp", slot="skew"),),
    slots=(Slot("skew", "s", "delay of the measurement", 3),),
    starts=grid("delay", at=lambda _here: [{"delay": 0.002}, {"delay": 0.015}]),
)
