"""Error of the link's inertia."""

from __future__ import annotations

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import one


def _write(spot: Spot, value: Values) -> None:
    total = spot["inertia"] + value["inertia"]
    if total <= 0.0:
        raise ParameterError(f"inertia {value['inertia']} leaves {total:.6g} kg m^2, must be > 0")


KIND = EffectKind(
    name="link_inertia",
    text="error of the link's inertia",
    term="M + inertia",
    confused_with="payload: changes gravity as well",
    sites=("link",),
    parameters=(
        EffectParameter(
            "inertia", "kg m^2", -1e6, 1e6, 0.0, "added to the device value", True, slot="inertia", adds=True
        ),
    ),
    write=_write,
    starts=one(inertia=lambda here: 0.1 * here.device.link.inertia),
)
