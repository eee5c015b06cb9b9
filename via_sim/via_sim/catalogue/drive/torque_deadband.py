"""A drive that passes no torque for small commands."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import thresholds
from via_sim.catalogue.terms import Term


def _passed(torque_deadband: float, torque: float) -> float:
    return torque * (abs(torque) >= torque_deadband)


KIND = EffectKind(
    name="torque_deadband",
    text="a drive that passes no torque while the command is smaller than a threshold",
    term="u for |u| >= threshold, else 0",
    confused_with="coulomb_friction: holds under a load; "
    "dead_zone, torque_gain, torque_saturation: large commands act in full",
    sites=("motor",),
    parameters=(
        EffectParameter("threshold", "N m", 0.0, 1e6, 0.0, "smallest command that passes", slot="torque_deadband"),
    ),
    slots=(Slot("torque_deadband", "N m", "commanded torques below it do not pass the drive", 3),),
    terms=(Term("command", _passed),),
    starts=thresholds("threshold", lambda here: here.peak),
    needs_torque_drive=True,
    of_drive=True,
    of_torque=True,
)
