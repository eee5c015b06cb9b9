"""Physics outside the catalogue, for which the right answer is 'none of these'."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import pi
from types import MappingProxyType

from numpy.random import Generator
from via_core.devices import Device

from via_gap.benchmark.menu import Entry, Numbers, Place, Shape
from via_gap.benchmark.physics import Physics, at, of_motor
from via_gap.benchmark.scene import Scene


def _any_axis(device: Device) -> tuple[Place, ...]:
    motors = tuple(("motor", i) for i in range(1, 1 + device.n_motors)) if device.drive == "torque" else ()
    return (("link", 0), *motors)


def _drives(device: Device) -> tuple[Place, ...]:
    return tuple(("motor", i) for i in range(1, 1 + device.n_motors)) if device.drive == "torque" else ()


def _springs(device: Device) -> tuple[Place, ...]:
    return tuple(("transmission", i) for i in range(1, 1 + device.n_transmissions))


def _at(site: str) -> Callable[[Device], tuple[Place, ...]]:
    return lambda _device: ((site, 0),)


def _order(rng: Generator, _scene: Scene) -> Shape:
    return {"order": float(rng.integers(6, 25))}


def _texture(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[axis]
    return Physics(texture=at(axis, torque), texture_order=at(axis, shape["order"])), {"torque": torque, **shape}


def _cooling(rng: Generator, _scene: Scene) -> Shape:
    return {"share": float(rng.uniform(0.15, 0.4))}


def _warming(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[axis]
    energy = shape["share"] * torque * scene.speed[axis] * scene.duration
    physics = Physics(warm_friction=at(axis, torque), warming_energy=at(axis, energy, 1.0))
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


def _none(_rng: Generator, _scene: Scene) -> Shape:
    return {}


def _soft_middle(scene: Scene, number: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    width = size * scene.deflection[number - 1]
    return Physics(soften=of_motor(number, width)), {"width": width}


def _time(rng: Generator, _scene: Scene) -> Shape:
    return {"time": float(rng.uniform(0.15, 0.6))}


def _unrest(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[0]
    return Physics(unrest=torque, unrest_time=shape["time"]), {"torque": torque, **shape}


def _relaxing(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    stiffness = size * scene.load[number - 1] / scene.deflection[number - 1]
    physics = Physics(relaxing=of_motor(number, stiffness), relaxation=of_motor(number, shape["time"], 1.0))
    return physics, {"stiffness": stiffness, **shape}


def _sag(scene: Scene, number: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    per_power = size / (scene.torque[number] * scene.speed[number])
    return Physics(sag=of_motor(number, per_power)), {"per_power": per_power}


def _slipping(_scene: Scene, _number: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    return Physics(skipping=size), {"step": size}


STRANGERS: Mapping[str, Entry] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Entry("textured_friction", _any_axis, 0.01, 1.0, _order, _texture),
            Entry("warming_friction", _any_axis, 0.02, 1.5, _cooling, _warming),
            Entry("extra_mode", _at("link"), 0.05, 1.5, _mode, _belt),
            Entry("soft_middle", _springs, 0.05, 2.0, _none, _soft_middle),
            Entry("random_torque", _at("environment"), 0.01, 1.0, _time, _unrest),
            Entry("relaxing_spring", _springs, 0.02, 1.5, _time, _relaxing),
            Entry("sagging_supply", _drives, 0.01, 0.5, _none, _sag),
            Entry("skipping_encoder", _at("sensor"), 1e-3, 0.1, _none, _slipping),
        )
    }
)
