"""An offset of an encoder."""

from __future__ import annotations

from math import pi

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import Typical, grid

TURN = 2.0 * pi  # [rad] more is the same angle; half a turn, the zero of many servos, is far from either end
OFF = (0.01, 0.1)  # [rad] starts: the first has an influence through springs, the second through gravity


def _offsets(here: Typical) -> tuple[float, ...]:
    """Half a turn is the zero of many servos; gravity shows it."""
    return (*OFF, pi) if here.device.link.gravity_torque else OFF


KIND = EffectKind(
    name="encoder_offset",
    text="an offset of an encoder; `motor` 0 is the link encoder",
    term="measures angle + offset",
    confused_with="preset_error, gravity_error: the other equations that use the angle",
    sites=("sensor",),
    parameters=(EffectParameter("offset", "rad", -TURN, TURN, 0.0, "added to the angle", slot="encoder_offset"),),
    slots=(Slot("encoder_offset", "rad", "added to the measurement: link, motor 1, motor 2", 3),),
    starts=grid("offset", at=lambda here: [{"offset": offset} for offset in _offsets(here)]),
)
