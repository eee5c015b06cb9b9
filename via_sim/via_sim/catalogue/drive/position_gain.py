"""A wrong position gain kp of a position drive: a wrong factor between register and torque, or another supply voltage.

The back EMF of the motor, and so kd, does not depend on either. A wrong torque constant changes both: torque_gain.
"""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import one


def _write(spot: Spot, value: Values) -> None:
    spot["drive_stiffness"] = spot["drive_stiffness"] * value["gain"]


KIND = EffectKind(
    name="position_gain",
    text="the position gain kp of a position drive, and ki with it, is gain times that of the device file; kd and the "
    "limits are not",
    term="gain kp e, e the error of the goal",
    confused_with="torque_gain: also kd and the torque limit",
    sites=("motor",),
    parameters=(EffectParameter("gain", "-", 0.0, 10.0, 1.0, "kp per kp of the device file", True),),
    write=_write,
    starts=one(gain=lambda _here: 1.05),
    of_drive=True,
    of_goal=True,
)
