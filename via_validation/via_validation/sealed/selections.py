"""Selections from the catalogue: for position drives, for controlled motors, and for both motors at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from via_validation.sealed.catalogue import (
    CATALOGUE,
    Entry,
    Numbers,
    Shape,
    at_site,
    drives,
    no_shape,
    signed,
    single,
    whole,
)
from via_validation.sealed.physics import Physics
from via_validation.sealed.scene import Scene

_SPEED_LIMIT = single("goal_speed", "limit", whole, lambda scene, _number, size: scene.speed[0] / size)
_BAND = single("goal_band", "width", whole, lambda scene, _number, size: size * (scene.angles[1] - scene.angles[0]))
_FEEDFORWARD = single("feedforward", "share", whole, lambda _scene, _number, size: size)
_POSITION_GAIN = single("position_gain", "gain", whole, lambda _scene, _number, size: 1.0 + size)


def _integral(_scene: Scene, _number: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    """Integral action that begins with the run."""
    return Physics(integral_rate=size), {"rate": size, "start": 0.0}


# Effects of position drives; only they have a goal.
OF_POSITION: Mapping[str, Entry] = MappingProxyType(
    {
        **{
            name: CATALOGUE[name]
            for name in (
                "coulomb_friction", "stribeck_friction", "viscous_friction", "load_dependent_friction", "payload",
                "torque_gain", "torque_ripple", "actuator_delay",
            )
        },
        "speed_limit": Entry("speed_limit", at_site("command"), 0.3, 3.0, no_shape, _SPEED_LIMIT),
        "position_gain": Entry("position_gain", drives, 0.15, 0.6, signed, _POSITION_GAIN),
        "integral_action": Entry("integral_action", drives, 0.2, 6.0, no_shape, _integral),
        "velocity_feedforward": Entry("velocity_feedforward", drives, 0.1, 1.5, no_shape, _FEEDFORWARD),
        "position_deadband": Entry("position_deadband", drives, 0.01, 0.4, no_shape, _BAND),
    }
)  # fmt: skip
# Effects of controlled motors. Sizes are relative to their nominal torque, which is small.
OF_CONTROL: Mapping[str, Entry] = MappingProxyType(
    {
        name: replace(CATALOGUE[name], high=high)
        for name, high in (
            ("torque_ripple", 4.0), ("coulomb_friction", 3.0), ("stribeck_friction", 2.0), ("viscous_friction", 40.0),
            ("asymmetric_coulomb", 3.0),
        )
    }
)  # fmt: skip
# Effects that can act on both motors as one cause.
OF_BOTH = (
    "coulomb_friction", "stribeck_friction", "viscous_friction", "quadratic_drag", "presliding_friction",
    "load_dependent_friction", "torque_gain", "torque_ripple", "torque_saturation",
)  # fmt: skip
