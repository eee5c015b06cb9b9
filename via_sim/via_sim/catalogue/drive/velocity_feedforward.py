"""Damping of a position drive that acts on the derivative of the error, as in most PID controllers, or a part of it."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import one

KIND = EffectKind(
    name="velocity_feedforward",
    text="the damping kd of a position drive also follows the speed of the goal, by a share beyond that of the device "
    "file; at 1 it acts on the derivative of the error",
    term="share kd dg/dt, g the goal",
    confused_with="actuator_delay, actuator_lag: later, not earlier; position_gain: in phase with the error",
    sites=("motor",),
    parameters=(
        EffectParameter(
            "share", "-", -10.0, 10.0, 0.0, "share of kd that follows the goal", True, slot="feedforward", adds=True
        ),
    ),
    slots=(Slot("feedforward", "-", "share of kd that acts on the speed of the goal of a position drive"),),
    starts=one(share=lambda _here: 0.2),
    of_drive=True,
    of_goal=True,
)
