"""What becomes of each effect and each device entry in each format: a slot, a substitute with its cost, or nothing.

The rows of slots_effects.py and slots_device.py are the table; docs/export.md and the losses of an export show it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from via_sim.effects import Effect, place_name

from via_export.target import Target

FORMATS = ("mjcf", "urdf", "sdf", "isaaclab", "bam", "ros2_control")
TITLES = {
    "mjcf": "MuJoCo 4", "urdf": "URDF", "sdf": "SDF 1.9", "isaaclab": "Isaac Lab", "bam": "BAM",
    "ros2_control": "ros2_control",
}  # fmt: skip
NO_PHYSICS = "- holds no physics; belongs into the simulator's model"
_NO_FEEDFORWARD = "- kd acts on the speed of the joint alone; add share times kd times the goal's speed at run time"
_NO_INTEGRAL = "- the drive has no integral; a custom actuator class can add it"
_NO_GAINS = "- gains belong to the controller"
# Texts of `row` for what a position drive can have by its device file or by an effect.
FEEDFORWARD = {
    "mjcf": _NO_FEEDFORWARD, "bam": _NO_FEEDFORWARD, "urdf": _NO_GAINS,
    "sdf": "~ JointPositionController d_gain | acts on the derivative of the error, which is a share of 1",
    "isaaclab": "~ velocity targets | set them to the speed of the goal times the share at run time",
    "ros2_control": "~ velocity references | set them to the speed of the goal times the share at run time",
}  # fmt: skip
INTEGRAL = {
    "mjcf": "= gainprm, dynprm of an actuator of gaintype pid", "sdf": "= JointPositionController i_gain, i_max, i_min",
    "ros2_control": "= pid_controller gain i, i_clamp_max, i_clamp_min",
    "isaaclab": _NO_INTEGRAL, "bam": _NO_INTEGRAL, "urdf": _NO_GAINS,
}  # fmt: skip
Kind = Literal["slot", "substitute", "none"]
Applies = Callable[[Target, Effect | None], bool]


@dataclass(frozen=True)
class Slot:
    """Where a format holds an effect or entry.

    where  the slot, or the closest substitute; empty if there is none
    cost   what is lost; empty for a slot
    """

    kind: Kind
    where: str = ""
    cost: str = ""

    @staticmethod
    def of(text: str) -> Slot:
        """'= slot', '~ substitute | cost', or '- cost'."""
        mark, rest = text[0], text[1:].strip()
        where, _, cost = rest.partition("|")
        if mark == "=":
            return Slot("slot", rest)
        return Slot("substitute", where.strip(), cost.strip()) if mark == "~" else Slot("none", "", rest)


@dataclass(frozen=True)
class Row:
    """One line of the table: an effect or a device entry, under a condition, with one slot per format."""

    item: str
    when: str
    slots: Mapping[str, Slot]
    applies: Applies


@dataclass(frozen=True)
class Loss:
    """Something of a device or its effects that a format does not hold exactly."""

    item: str
    place: str
    slot: Slot

    def __str__(self) -> str:
        where = f"{self.item} at {self.place}" if self.place else self.item
        if self.slot.kind == "none":
            return f"{where}: no slot; {self.slot.cost}"
        return f"{where}: no slot; written as {self.slot.where}; cost: {self.slot.cost}"


def row(item: str, when: str = "", applies: Applies | None = None, others: str = "", **texts: str) -> Row:
    """A line of the table from one text per format, see `Slot.of`.

    others  text of the formats that are left out, except ros2_control: NO_PHYSICS
    """
    every = {**dict.fromkeys(FORMATS, others), "ros2_control": NO_PHYSICS, **texts}
    slots = {name: Slot.of(text) for name, text in every.items()}
    return Row(item, when, slots, applies or (lambda _target, _effect: True))


def servo(target: Target, _effect: Effect | None) -> bool:
    return target.device.drive == "servo"


def position_drive(target: Target, _effect: Effect | None) -> bool:
    return target.device.drive == "position"


def by_levers(target: Target, _effect: Effect | None) -> bool:
    """A spring between levers, whose torque depends on a preset."""
    return target.depends_on_preset


def losses(target: Target, to: str) -> tuple[Loss, ...]:
    """What a format loses of a device with effects: first of the effects, then of the device."""
    return tuple(loss for loss in _all(target, to) if loss.slot.kind != "slot")


def _all(target: Target, to: str) -> Iterator[Loss]:
    from via_export.slots_device import DEVICE_ROWS
    from via_export.slots_effects import EFFECT_ROWS

    for effect in target.effects:
        line = next(line for line in EFFECT_ROWS if line.item == effect.name and line.applies(target, effect))
        yield Loss(effect.name, place_name(effect.site, effect.motor), line.slots[to])
    for line in DEVICE_ROWS:
        if line.applies(target, None):
            yield Loss(f"{line.item} ({line.when})" if line.when else line.item, "", line.slots[to])
