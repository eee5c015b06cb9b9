"""Error of the gravity torque."""

from __future__ import annotations

from math import pi

from via_sim.catalogue.kinds import EffectKind, EffectParameter
from via_sim.catalogue.starts import Start, Starts, Typical, tenth

_ADDED = "added to the device value"
_NAMES = ("torque", "angle")


def _starts(here: Typical) -> list[Start]:
    return [Start(({"torque": tenth(here)}, {"angle": 0.1}), _NAMES, about=here.device.link.gravity_torque)]


KIND = EffectKind(
    name="gravity_error",
    text="error of the gravity torque, or of the angle at which the link hangs at rest",
    term="(gravity_torque + torque) sin(q - gravity_angle - angle)",
    confused_with="payload: changes inertia as well",
    sites=("link",),
    parameters=(
        EffectParameter("torque", "N m", -1e6, 1e6, 0.0, _ADDED, True, slot="gravity_torque", adds=True),
        EffectParameter("angle", "rad", -pi, pi, 0.0, _ADDED, slot="gravity_angle", adds=True),
    ),
    starts=Starts(_NAMES, _starts),
)
