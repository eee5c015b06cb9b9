"""Error of the viscous friction of the device file."""

from __future__ import annotations

from via_core.errors import ParameterError

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Spot, Values
from via_sim.catalogue.starts import one, tenth_viscous


def add_viscous(spot: Spot, mean: float, half: float, given: str) -> None:
    """Add mean and half the difference of both directions [N m s/rad]; refuse friction that would drive the axis."""
    total, skewed = spot["viscous_friction"] + mean, spot["viscous_asymmetry"] + half
    if total - abs(skewed) < 0.0:
        raise ParameterError(f"{given} leaves {total - abs(skewed):.6g} N m s/rad of viscous friction, must be >= 0")
    spot["viscous_friction"], spot["viscous_asymmetry"] = total, skewed


def _write(spot: Spot, value: Values) -> None:
    add_viscous(spot, value["coefficient"], 0.0, f"coefficient {value['coefficient']}")


KIND = EffectKind(
    name="viscous_friction",
    text="error of the viscous friction coefficient of the device file",
    term="-coefficient v",
    confused_with="coulomb_friction: several speeds",
    sites=("motor", "link"),
    needs_torque_drive=True,
    parameters=(EffectParameter("coefficient", "N m s/rad", -1e6, 1e6, 0.0, "added to the device value", True),),
    write=_write,
    starts=one(coefficient=tenth_viscous),
    adds=True,
)
