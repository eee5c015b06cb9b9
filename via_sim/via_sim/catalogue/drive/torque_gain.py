"""Gain of a drive or of a torque sensor."""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot, Spot, Values
from via_sim.catalogue.starts import one


def _write(spot: Spot, value: Values) -> None:
    slot = "sensed_gain" if spot.site == "sensor" else "torque_gain"
    spot[slot] = spot[slot] * value["gain"]  # the device file may scale torques as well
    if spot.site != "sensor":
        spot["drive_damping"] = spot["drive_damping"] * value["gain"]  # of a position drive; 0 in others


KIND = EffectKind(
    name="torque_gain",
    text="the motor torque is gain times the command; at a sensor the measured torque is gain times the torque",
    term="gain u",
    confused_with="all parameters scaled: one known mass; position_gain: not the damping kd of a position drive",
    sites=("motor", "sensor"),
    parameters=(
        EffectParameter("gain", "-", 0.0, 10.0, 1.0, "torque per commanded torque; measured torque per torque", True),
    ),
    slots=(
        Slot("torque_gain", "-", "torque per commanded torque: drive of a rigid joint, motor 1, motor 2", 3, 1.0),
        Slot("sensed_gain", "-", "measured torque per torque: link, motor 1, motor 2", 3, 1.0),
    ),
    write=_write,
    starts=one(gain=lambda _here: 1.05),
    needs_torque_drive=True,
    of_drive=True,
)
