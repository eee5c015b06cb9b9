"""An unknown limit of a drive."""

from __future__ import annotations

from math import inf

from via_sim.catalogue.kinds import NEVER, EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import Typical, limits
from via_sim.catalogue.terms import Term


def _clipped(saturation: float, torque: float) -> float:
    return min(max(torque, -saturation), saturation)


def _limits(here: Typical) -> list[float]:
    if here.device.drive == "servo":
        return [share * here.slew for share in (0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)]
    return [share * here.peak for share in (0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96, 0.985)]


KIND = EffectKind(
    name="torque_saturation",
    text="an unknown limit of the drive torque; of a servo a limit of its speed [rad/s]",
    term="clip(u, -limit, limit)",
    confused_with="torque_gain: only large commands",
    sites=("motor",),
    parameters=(
        EffectParameter(
            "limit", "N m", 1e-3, NEVER, NEVER, "largest torque; of a servo largest speed", servo_unit="rad/s",
            slot="saturation",
        ),
    ),
    slots=(Slot("saturation", "N m, rad/s", "unknown limit of drive torque, of a servo its speed", 3, inf),),
    terms=(Term("command", _clipped),),
    starts=limits(_limits, of_peak=True),
    of_drive=True,
)  # fmt: skip
