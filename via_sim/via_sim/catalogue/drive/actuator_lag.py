"""A first-order lag of all drives."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one

KIND = EffectKind(
    name="actuator_lag",
    text="a first-order lag between command and torque of all drives; of a servo added to 2/w; of a position drive "
    "it acts on the goal",
    term="T dy/dt = u - y",
    confused_with="actuator_delay: the step response starts immediately",
    sites=("command",),
    parameters=(EffectParameter("time_constant", "s", 0.0, 0.5, 0.0, "T", slot="lag"),),
    slots=(Slot("lag", "s", "first-order time constant between command and torque; added to 2/w of a servo"),),
    starts=one(time_constant=lambda _here: 0.004),
)
