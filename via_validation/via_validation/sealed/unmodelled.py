"""Unmodelled effects outside the catalogue; the right verdict for them is `unknown`."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from types import MappingProxyType

from numpy.random import Generator

from via_validation.sealed.catalogue import (
    Entry,
    Numbers,
    Shape,
    at_site,
    axes,
    motors,
    no_shape,
    single,
    transmissions,
    whole,
)
from via_validation.sealed.physics import Physics, at_axis, at_motor
from via_validation.sealed.scene import Scene


def _order(rng: Generator, _scene: Scene) -> Shape:
    return {"order": float(rng.integers(6, 25))}


def _texture(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[axis]
    return Physics(texture=at_axis(axis, torque), texture_order=at_axis(axis, shape["order"])), {
        "torque": torque,
        **shape,
    }


def _cooling(rng: Generator, _scene: Scene) -> Shape:
    return {"share": float(rng.uniform(0.15, 0.4))}


def _warming(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[axis]
    energy = shape["share"] * torque * scene.speed[axis] * scene.duration
    physics = Physics(warm_friction=at_axis(axis, torque), warming_energy=at_axis(axis, energy, 1.0))
    return physics, {"torque": torque, "energy": energy}


def _mode(rng: Generator, _scene: Scene) -> Shape:
    return {"frequency": float(rng.uniform(4.0, 12.0)), "damping": float(rng.uniform(0.03, 0.1))}


def _belt(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    inertia, w = size * scene.device.link.inertia, 2.0 * pi * shape["frequency"]
    physics = Physics(
        follower_inertia=inertia,
        follower_stiffness=inertia * w * w,
        follower_damping=2.0 * shape["damping"] * inertia * w,
    )
    return physics, {"inertia": inertia, **shape}


def _time(rng: Generator, _scene: Scene) -> Shape:
    return {"time": float(rng.uniform(0.15, 0.6))}


def _unrest(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[0]
    return Physics(unrest=torque, unrest_time=shape["time"]), {"torque": torque, **shape}


def _relaxing(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    stiffness = size * scene.load[number - 1] / scene.deflection[number - 1]
    physics = Physics(relaxing=at_motor(number, stiffness), relaxation=at_motor(number, shape["time"], 1.0))
    return physics, {"stiffness": stiffness, **shape}


_SOFT_MIDDLE = single("soften", "width", at_motor, lambda scene, number, size: size * scene.deflection[number - 1])
_SAG = single("sag", "per_power", at_motor, lambda scene, k, size: size / (scene.torque[k] * scene.speed[k]))
_SLIPPING = single("skipping", "step", whole, lambda _scene, _number, size: size)

UNMODELLED: Mapping[str, Entry] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Entry("textured_friction", axes, 0.01, 1.0, _order, _texture),
            Entry("warming_friction", axes, 0.02, 1.5, _cooling, _warming),
            Entry("extra_mode", at_site("link"), 0.05, 1.5, _mode, _belt),
            Entry("soft_middle", transmissions, 0.05, 2.0, no_shape, _SOFT_MIDDLE),
            Entry("random_torque", at_site("environment"), 0.01, 1.0, _time, _unrest),
            Entry("relaxing_spring", transmissions, 0.02, 1.5, _time, _relaxing),
            Entry("sagging_supply", motors, 0.01, 0.5, no_shape, _SAG),
            Entry("skipping_encoder", at_site("sensor"), 1e-3, 0.1, no_shape, _SLIPPING),
        )
    }
)
