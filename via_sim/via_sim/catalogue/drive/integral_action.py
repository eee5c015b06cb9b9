"""Integral action of a position drive: its torque grows while an error lasts, and holds loads without one.

A cascade of a position loop (gain a) and a speed loop with proportional and integral part (gains b, c) is the same
drive with kp = a b + c, kd = b and ki = a c.
"""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import grid

RATES = (0.5, 5.0)  # [1/s] starts

KIND = EffectKind(
    name="integral_action",
    text="integral action of a position drive beyond that of the device file; it is limited as the torque of the drive "
    "is, and starts anew when the drive is switched on",
    term="kp z, dz/dt = rate e, kp z = start at first; e the error of the goal",
    confused_with="gravity_error, encoder_offset: a load without integral action leaves a lasting error; "
    "position_gain: also at the beginning of a step",
    sites=("motor",),
    parameters=(
        EffectParameter("rate", "1/s", 0.0, 200.0, 0.0, "ki / kp", True, slot="integral_rate", adds=True),
        EffectParameter(
            "start", "N m", -1e3, 1e3, 0.0, "torque of the integral at the beginning of a recording", True,
            slot="integral_start", adds=True,
        ),
    ),
    slots=(
        Slot("integral_rate", "1/s", "ki / kp of the position drive"),
        Slot("integral_start", "N m", "torque of its integral at the beginning of a run"),
    ),
    starts=grid("rate", at=lambda _here: [{"rate": rate, "start": 0.0} for rate in RATES]),
    of_drive=True,
    of_goal=True,
)  # fmt: skip
