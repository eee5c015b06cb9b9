"""Dead time of all commands."""

from __future__ import annotations

from via_core.device_parts import LONGEST_DELAY
from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import grid

MAX_DELAY = LONGEST_DELAY  # [s] with that of the drive


def _write(spot: Spot, value: Values) -> None:
    total = spot["delay"] + value["delay"]
    if total > MAX_DELAY:
        raise ParameterError(f"delay {value['delay']} plus that of the drive is {total:.6g} s, must be <= {MAX_DELAY}")


KIND = EffectKind(
    name="actuator_delay",
    text="dead time of all commands, in any fraction of a tick, in addition to that of a position drive",
    term="u(t - delay)",
    confused_with="actuator_lag, friction, a filter: linear in frequency, not in 1/v",
    sites=("command",),
    parameters=(EffectParameter("delay", "s", 0.0, MAX_DELAY, 0.0, "dead time", slot="delay", adds=True),),
    write=_write,
    starts=grid("delay", at=lambda _here: [{"delay": 0.004}, {"delay": 0.03}]),
)
