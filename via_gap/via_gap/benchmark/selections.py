"""Parts of the catalogue for joints that cannot show all of it, with the one effect that only they have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from numpy.random import Generator
from via_core.devices import Device

from via_gap.benchmark.menu import MENU, Entry, Numbers, Place, Shape
from via_gap.benchmark.physics import Physics
from via_gap.benchmark.scene import Scene


def _command(_device: Device) -> tuple[Place, ...]:
    return (("command", 0),)


def _no_shape(_rng: Generator, _scene: Scene) -> Shape:
    return {}


def _goal_speed(scene: Scene, _number: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    limit = scene.speed[0] / size
    return Physics(goal_speed=limit), {"limit": limit}


# Of position drives: what such a drive can have, and its own speed limit, which no other drive has.
OF_POSITION: Mapping[str, Entry] = MappingProxyType(
    {
        **{
            name: MENU[name]
            for name in (
                "coulomb_friction", "stribeck_friction", "viscous_friction", "load_dependent_friction", "payload",
                "torque_ripple", "actuator_delay",
            )
        },
        "speed_limit": Entry("speed_limit", _command, 0.3, 3.0, _no_shape, _goal_speed),
    }
)  # fmt: skip
# Of light motors under control, whose nominal torque is small: sizes are relative to it.
OF_CONTROL: Mapping[str, Entry] = MappingProxyType(
    {
        name: replace(MENU[name], high=high)
        for name, high in (
            ("torque_ripple", 4.0), ("coulomb_friction", 3.0), ("stribeck_friction", 2.0), ("viscous_friction", 40.0),
            ("asymmetric_coulomb", 3.0),
        )
    }
)  # fmt: skip
# Effects of a motor that two motors can have alike, as one cause.
OF_BOTH = (
    "coulomb_friction", "stribeck_friction", "viscous_friction", "quadratic_drag", "presliding_friction",
    "load_dependent_friction", "torque_gain", "torque_ripple", "torque_saturation",
)  # fmt: skip
