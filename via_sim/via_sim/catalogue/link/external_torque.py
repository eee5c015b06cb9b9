"""An unrecorded torque on the link."""

from __future__ import annotations

import numpy as np
from via_core.errors import ParameterError

from via_sim.catalogue.kinds import NEVER, EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import Typical, grid

EDGES = 7  # grid of beginnings and ends


def _write(_spot: Spot, value: Values) -> None:
    if value["stop"] < value["start"]:
        raise ParameterError(f"stop {value['stop']} s must not be before start {value['start']} s")


def _starts(here: Typical) -> list[dict[str, float]]:
    torque, edges = 0.1 * here.torque, np.linspace(0.0, here.duration, EDGES)
    spans = [*here.busy, *((a, b) for i, a in enumerate(edges) for b in edges[i + 1 :])]
    return [*({"torque": torque, "start": float(a), "stop": float(b)} for a, b in spans), {"torque": torque}]


_SINCE = "time since the beginning of the run"
KIND = EffectKind(
    name="external_torque",
    text="an unrecorded torque on the link, constant from start until stop",
    term="torque for start <= t < stop, t since the beginning of the run",
    confused_with="gravity_error, torque_bias: depends on time and not on the angle",
    sites=("environment",),
    parameters=(
        EffectParameter("torque", "N m", -1e6, 1e6, 0.0, "on the link", True, slot="pulse_torque"),
        EffectParameter("start", "s", 0.0, NEVER, 0.0, _SINCE, slot="pulse_start"),
        EffectParameter("stop", "s", 0.0, NEVER, NEVER, _SINCE, slot="pulse_stop"),
    ),
    slots=(
        Slot("pulse_torque", "N m", "on the link, from pulse_start until pulse_stop"),
        Slot("pulse_start", "s", "age of the run"),
        Slot("pulse_stop", "s", "age of the run"),
    ),
    write=_write,
    starts=grid("torque", at=_starts),
    one_run=True,
)
