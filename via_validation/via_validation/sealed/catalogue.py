"""Catalogue of the second simulator: the named effects, their locations and their physics.

It was written from the specification alone and shares nothing with via_sim's catalogue. An entry lists the locations of
the effect in a joint, draws its shape (order, direction, position), and returns Physics for a relative size within
[low, high]. The search for the wanted gap over noise changes only the size. If a wrong parameter in the device file has
the same effect (inertia, friction, stiffness, gain), the smallest size is well outside the file's tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, pi
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.random import Generator
from via_core.device_parts import TorqueMotor
from via_core.devices import Device

from via_validation.sealed.physics import HARMONICS, Physics, at_axis, at_motor, terms_at
from via_validation.sealed.scene import Scene

STEEPEST = 0.8  # largest derivative of a gear's error: it must not turn backwards
TICK = 0.5e-3  # [s] delays are whole multiples
Shape = Mapping[str, float]
Numbers = dict[str, float]
Location = tuple[str, int]  # site, number of the motor or transmission (0: none)
Amount = Callable[[Scene, int, float], float]  # (scene, number, relative size) -> parameter of an effect
Make = Callable[[Scene, int, float, Shape], tuple[Physics, Numbers]]  # (scene, number, size, shape) -> effect


@dataclass(frozen=True)
class Entry:
    """One named effect.

    locations  possible locations in a device
    low, high  [-] range of the relative size
    shape      draws the parameters that do not depend on the size
    make       physics and parameters for a size
    most       largest magnitude of a parameter; beyond it the joint would be a different one
    sensed     like `make`, for the effect in a torque sensor
    """

    name: str
    locations: Callable[[Device], tuple[Location, ...]]
    low: float
    high: float
    shape: Callable[[Generator, Scene], Shape]
    make: Make
    most: float = inf
    sensed: Make | None = None

    def of_size(self, scene: Scene, location: Location, size: float, shape: Shape) -> tuple[Physics, Numbers]:
        make = self.sensed if self.sensed is not None and location[0] == "sensor" else self.make
        return make(scene, location[1], size, shape)


def axes(device: Device) -> tuple[Location, ...]:
    return (("link", 0), *motors(device))


def motors(device: Device) -> tuple[Location, ...]:
    return tuple(("motor", i) for i in range(1, 1 + device.n_motors)) if device.drive == "torque" else ()


def drives(device: Device) -> tuple[Location, ...]:
    """Motors with commanded torque; the drive of a rigid joint is its motor 1."""
    return motors(device) if device.motors else (("motor", 1),)


def _torques(device: Device) -> tuple[Location, ...]:
    """Motors with commanded torque, and their torque sensors."""
    return (*drives(device), *(("sensor", number) for _, number in motors(device)))


def transmissions(device: Device) -> tuple[Location, ...]:
    return tuple(("transmission", i) for i in range(1, 1 + device.n_transmissions))


def _presets(device: Device) -> tuple[Location, ...]:
    return transmissions(device) if device.arrangement in ("antagonistic", "serial") else ()


def _encoders(device: Device) -> tuple[Location, ...]:
    return tuple(("sensor", i) for i in range(1 + device.n_motors))


def _clocks(device: Device) -> tuple[Location, ...]:
    return tuple(("timing", i) for i in range(1 + device.n_motors))


def _with_gravity(device: Device) -> tuple[Location, ...]:
    return (("link", 0),) if device.link.gravity_torque else ()


def at_site(site: str, drive: str = "") -> Callable[[Device], tuple[Location, ...]]:
    return lambda device: ((site, 0),) if drive in ("", device.drive) else ()


def no_shape(_rng: Generator, _scene: Scene) -> Shape:
    return {}


def _uniform(name: str, low: float, high: float) -> Callable[[Generator, Scene], Shape]:
    return lambda rng, _scene: {name: float(rng.uniform(low, high))}


def signed(rng: Generator, _scene: Scene) -> Shape:
    return {"sign": float(rng.choice([-1.0, 1.0]))}


def single(field: str, parameter: str, to_field: Callable[[int, float], Any], amount: Amount) -> Make:
    """`make` of an effect that is one field of Physics and one parameter; the shape gives the sign."""

    def make(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
        value = amount(scene, number, shape.get("sign", 1.0) * size)
        return Physics(**{field: to_field(number, value)}), {parameter: value}

    return make


def whole(_number: int, value: float) -> float:
    """The value itself, for a field that is one number for the whole joint."""
    return value


def _quantum_of(scene: Scene, axis: int) -> float:
    sensors = scene.device.sensors
    return (sensors.motor_quantum if axis else sensors.link_quantum) or 0.0


def _viscous_of(scene: Scene, axis: int) -> float:
    motor = scene.device.motors[axis - 1] if axis else None
    return motor.viscous_friction if isinstance(motor, TorqueMotor) else scene.device.link.viscous_friction


def _uneven(rng: Generator, _scene: Scene) -> Shape:
    return {"sign": float(rng.choice([-1.0, 1.0])), "share": float(rng.uniform(0.3, 0.8))}


def _asymmetric_coulomb(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.torque[axis]
    half = shape["sign"] * shape["share"] * torque
    numbers = {"forward": torque + half, "backward": torque - half}
    return Physics(friction=at_axis(axis, torque), uneven=at_axis(axis, half)), numbers


def _stribeck_shape(rng: Generator, scene: Scene) -> Shape:
    return {"excess": float(rng.uniform(0.6, 1.6)), "velocity": float(rng.uniform(0.05, 0.25))}


def _stribeck(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    kinetic = size * scene.torque[axis]
    excess, velocity = shape["excess"] * kinetic, shape["velocity"] * scene.speed[axis]
    physics = Physics(
        friction=at_axis(axis, kinetic), breakaway=at_axis(axis, excess), stribeck_velocity=at_axis(axis, velocity, 1.0)
    )
    return physics, {"breakaway": kinetic + excess, "kinetic": kinetic, "velocity": velocity}


def _asymmetric_viscous(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    more = size * _viscous_of(scene, axis)
    half = 0.5 * more
    forward, backward = (more, 0.0) if shape["sign"] > 0.0 else (0.0, more)
    physics = Physics(viscous=at_axis(axis, half), uneven_viscous=at_axis(axis, shape["sign"] * half))
    return physics, {"forward": forward, "backward": backward}


def _bristle_length(rng: Generator, _scene: Scene) -> Shape:
    return {"length": float(np.exp(rng.uniform(np.log(0.01), np.log(0.05))))}


def _presliding(scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque, length = size * scene.torque[axis], shape["length"]
    physics = Physics(bristle=at_axis(axis, torque), bristle_length=at_axis(axis, length, 1.0))
    return physics, {"torque": torque, "stiffness": torque / length}


def _hysteresis(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = size * scene.load[number - 1]
    stiffness = torque / (shape["travel"] * scene.deflection[number - 1])
    physics = Physics(slip_torque=at_motor(number, torque), slip_stiffness=at_motor(number, stiffness))
    return physics, {"torque": torque, "stiffness": stiffness}


def _spring_law(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    hardening = shape["sign"] * size / (2.0 * scene.deflection[number - 1] ** 2)
    if shape["sign"] < 0.0:
        hardening *= 0.4  # the torque must not vanish at twice the RMS deflection
    return Physics(hardening=at_motor(number, hardening)), {"scale": 1.0, "hardening": hardening}


def _preset(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    if scene.device.arrangement == "serial":
        offset = shape["sign"] * size
        return Physics(preset_shift=offset), {"offset": offset}
    offset = shape["sign"] * size * scene.deflection[number - 1]
    return Physics(rest=at_motor(number, offset)), {"offset": offset}


def _neighbour(rng: Generator, _scene: Scene) -> Shape:
    return {"sign": float(rng.choice([-1.0, 1.0])), "period": float(rng.uniform(1.5, 4.0))}


def _coupling(scene: Scene, _number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    stiffness = shape["sign"] * size * scene.torque[0]
    return Physics(coupling=stiffness, neighbour_period=shape["period"]), {"stiffness": stiffness}


def _terms(rng: Generator, first: Shape, orders: Sequence[int]) -> Shape:
    """`first`, and in half of the cases one to three weaker terms of other orders."""
    shape, more = dict(first), int(rng.integers(1, HARMONICS)) if rng.uniform() < 0.5 else 0
    others = [order for order in orders if order != first["order"]]
    for k, order in enumerate(rng.choice(others, more, replace=False), 2):
        shape |= {f"order_{k}": float(order), f"phase_{k}": float(rng.uniform(-pi, pi))}
        shape[f"share_{k}"] = float(rng.uniform(0.3, 0.9))
    return shape


def _series(shape: Shape, size: float) -> tuple[list[float], list[float], list[float], Numbers]:
    """Amplitudes, orders and phases of a periodic effect, and all of them as named in the key."""
    names = ["", *(f"_{k}" for k in range(2, HARMONICS + 1) if f"order_{k}" in shape)]
    amplitudes = [size * shape.get(f"share{name}", 1.0) for name in names]
    orders, phases = [shape[f"order{name}"] for name in names], [shape[f"phase{name}"] for name in names]
    numbers: Numbers = {}
    for name, amplitude, order, phase in zip(names, amplitudes, orders, phases):
        numbers |= {f"amplitude{name}": amplitude, f"order{name}": order, f"phase{name}": phase}
    return amplitudes, orders, phases, numbers


def _order(rng: Generator, _scene: Scene) -> Shape:
    return _terms(rng, {"order": float(rng.integers(8, 40)), "phase": float(rng.uniform(-pi, pi))}, range(4, 49))


def _ripple(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    amplitudes, orders, phases, numbers = _series(shape, size * scene.torque[number])
    physics = Physics(
        ripple=terms_at(number - 1, 2, amplitudes),
        ripple_order=terms_at(number - 1, 2, orders),
        ripple_phase=terms_at(number - 1, 2, phases),
    )
    return physics, numbers


def _phase(rng: Generator, _scene: Scene) -> Shape:
    return _terms(rng, {"order": 1.0, "phase": float(rng.uniform(-pi, pi))}, range(2, 9))


def _eccentricity(_scene: Scene, axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    amplitudes, orders, phases, numbers = _series(shape, size)
    physics = Physics(
        eccentricity=terms_at(axis, 3, amplitudes),
        eccentric_order=terms_at(axis, 3, orders, 1.0),
        eccentric_phase=terms_at(axis, 3, phases),
    )
    if len(amplitudes) == 1:
        del numbers["order"]  # an eccentric disc has order 1
    return physics, numbers


def _gear_orders(rng: Generator, _scene: Scene) -> Shape:
    return _terms(rng, {"order": float(rng.integers(2, 12)), "phase": float(rng.uniform(-pi, pi))}, range(2, 13))


def _gear(scene: Scene, number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    amplitudes, orders, phases, numbers = _series(shape, size * scene.deflection[number - 1])
    steepest = sum(amplitude * order for amplitude, order in zip(amplitudes, orders))
    if steepest > STEEPEST:
        return _gear(scene, number, size * 0.999 * STEEPEST / steepest, shape)
    physics = Physics(
        gear=terms_at(number - 1, 2, amplitudes),
        gear_order=terms_at(number - 1, 2, orders, 1.0),
        gear_phase=terms_at(number - 1, 2, phases),
    )
    return physics, numbers


def _payload(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    mass = size * scene.device.link.inertia / shape["arm"] ** 2
    return Physics(payload_mass=mass, payload_arm=shape["arm"]), {"mass": mass, "distance": shape["arm"]}


def _inertia(scene: Scene, _axis: int, size: float, _shape: Shape) -> tuple[Physics, Numbers]:
    return Physics(inertia=1.0 + size), {"inertia": size * scene.device.link.inertia}


def _gravity(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    factor = 1.0 + shape["sign"] * size
    return Physics(gravity=factor), {"torque": shape["sign"] * size * scene.device.link.gravity_torque, "angle": 0.0}


def _tie(scene: Scene, _axis: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    low, high = scene.angles
    stiffness, rest = size * scene.torque[0] / (high - low), low + shape["share"] * (high - low)
    return Physics(tie_stiffness=stiffness, tie_rest=rest), {"stiffness": stiffness, "rest": rest}


def _wall(rng: Generator, _scene: Scene) -> Shape:
    return {"side": float(rng.choice([-1.0, 1.0])), "depth": float(rng.uniform(0.03, 0.12))}


def _contact(scene: Scene, _number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    low, high = scene.angles
    side, depth = shape["side"], shape["depth"] * (high - low)
    angle = high - depth if side > 0.0 else low + depth
    stiffness = size * scene.torque[0] / depth
    damping = 0.02 * stiffness
    physics = Physics(wall=angle, wall_side=side, wall_stiffness=stiffness, wall_damping=damping)
    return physics, {"angle": angle, "side": side, "stiffness": stiffness, "damping": damping}


def _interval(rng: Generator, scene: Scene) -> Shape:
    start = float(rng.uniform(0.1, 0.5)) * scene.duration
    stop = start + float(rng.uniform(0.15, 0.4)) * scene.duration
    return {"sign": float(rng.choice([-1.0, 1.0])), "start": start, "stop": stop}


def _external(scene: Scene, _number: int, size: float, shape: Shape) -> tuple[Physics, Numbers]:
    torque = shape["sign"] * size * scene.torque[0]
    physics = Physics(push=torque, push_from=shape["start"], push_until=shape["stop"])
    return physics, {"torque": torque, "start": shape["start"], "stop": shape["stop"]}


# Effects with one parameter: field of Physics, parameter, and its value as a function of axis or motor and size.
_COULOMB = single("friction", "torque", at_axis, lambda scene, axis, size: size * scene.torque[axis])
_VISCOUS = single("viscous", "coefficient", at_axis, lambda scene, axis, size: size * _viscous_of(scene, axis))
_DRAG = single("drag", "coefficient", at_axis, lambda s, axis, size: size * s.torque[axis] / s.speed[axis] ** 2)
_LOADED = single("load_friction", "coefficient", at_axis, lambda _scene, _axis, size: size)
_BACKLASH = single("gap", "gap", at_motor, lambda scene, number, size: size * scene.deflection[number - 1])
_SPRING_DAMPING = single(
    "spring_damping", "coefficient", at_motor, lambda s, k, size: size * s.load[k - 1] / (s.speed[0] + s.speed[k])
)
_DRIFT = single("drift", "rate", at_motor, lambda scene, _number, size: size / scene.duration)
_GAIN, _SENSED_GAIN = (
    single(field, "gain", lambda motor, value: at_motor(motor, value, 1.0), lambda _scene, _number, size: 1.0 + size)
    for field in ("gain", "sensed_gain")
)
_BIAS, _SENSED_BIAS = (
    single(field, "torque", at_motor, lambda scene, number, size: size * scene.torque[number])
    for field in ("bias", "sensed_bias")
)
_SATURATION = single(
    "limit", "limit", lambda k, value: at_motor(k, value, inf), lambda scene, k, size: (1.0 - size) * scene.highest[k]
)
_DEADBAND = single("deadband", "threshold", at_motor, lambda scene, k, size: size * scene.torque[k])
_DEAD_ZONE = single("dead_zone", "width", at_motor, lambda scene, k, size: size * scene.torque[k])
_LAG = single("lag", "time_constant", whole, lambda _scene, _number, size: size)
_DELAY = single("delay", "delay", whole, lambda _scene, _number, size: max(round(size / TICK), 1) * TICK)
_OFFSET = single("offset", "offset", at_axis, lambda _scene, _axis, size: size)
_QUANTISATION = single("quantum", "quantum", at_axis, lambda scene, axis, size: size * _quantum_of(scene, axis))
_SKEW = single("skew", "delay", at_axis, lambda _scene, _axis, size: size)

CATALOGUE: Mapping[str, Entry] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Entry("coulomb_friction", axes, 0.01, 1.0, no_shape, _COULOMB),
            Entry("asymmetric_coulomb", axes, 0.01, 1.0, _uneven, _asymmetric_coulomb),
            Entry("stribeck_friction", axes, 0.01, 0.6, _stribeck_shape, _stribeck),
            Entry("viscous_friction", axes, 0.25, 5.0, no_shape, _VISCOUS),
            Entry("asymmetric_viscous", axes, 0.25, 6.0, signed, _asymmetric_viscous),
            Entry("quadratic_drag", axes, 0.02, 2.0, no_shape, _DRAG),
            Entry("presliding_friction", axes, 0.01, 1.0, _bristle_length, _presliding),
            Entry("load_dependent_friction", axes, 0.02, 0.6, no_shape, _LOADED),
            Entry("backlash", transmissions, 0.02, 1.2, no_shape, _BACKLASH, 0.5),
            Entry("hysteresis", transmissions, 0.02, 0.8, _uniform("travel", 0.1, 0.4), _hysteresis),
            Entry("spring_damping", transmissions, 0.02, 2.0, no_shape, _SPRING_DAMPING),
            Entry("spring_law", transmissions, 0.15, 3.0, signed, _spring_law, 900.0),
            Entry("stiffness_drift", transmissions, 0.2, 0.9, signed, _DRIFT),
            Entry("preset_error", _presets, 0.005, 1.0, signed, _preset),
            Entry("gear_error", transmissions, 0.02, 0.8, _gear_orders, _gear),
            Entry("joint_coupling", at_site("link"), 0.02, 2.0, _neighbour, _coupling),
            Entry("torque_gain", _torques, 0.15, 0.6, signed, _GAIN, sensed=_SENSED_GAIN),
            Entry("torque_bias", _torques, 0.01, 0.8, signed, _BIAS, sensed=_SENSED_BIAS),
            Entry("torque_ripple", drives, 0.01, 0.8, _order, _ripple),
            Entry("torque_saturation", drives, 0.1, 0.85, no_shape, _SATURATION),
            Entry("torque_deadband", drives, 0.02, 1.0, no_shape, _DEADBAND),
            Entry("dead_zone", drives, 0.01, 0.6, no_shape, _DEAD_ZONE),
            Entry("actuator_lag", at_site("command", "torque"), 0.5e-3, 0.04, no_shape, _LAG),
            Entry("actuator_delay", at_site("command"), 1e-3, 0.04, no_shape, _DELAY),
            Entry("encoder_offset", _encoders, 1e-4, 0.2, signed, _OFFSET),
            Entry("encoder_eccentricity", _encoders, 1e-4, 0.15, _phase, _eccentricity),
            Entry("encoder_quantisation", _encoders, 3.0, 64.0, no_shape, _QUANTISATION),
            Entry("channel_skew", _clocks, 0.2e-3, 0.03, no_shape, _SKEW),
            Entry("payload", _with_gravity, 0.15, 3.0, _uniform("arm", 0.1, 0.4), _payload),
            Entry("link_inertia", at_site("link"), 0.15, 2.0, no_shape, _inertia),
            Entry("gravity_error", _with_gravity, 0.15, 0.9, signed, _gravity),
            Entry("link_spring", at_site("link"), 0.05, 5.0, _uniform("share", -0.5, 1.5), _tie),
            Entry("contact", at_site("environment"), 0.5, 50.0, _wall, _contact),
            Entry("external_torque", at_site("environment"), 0.02, 1.5, _interval, _external),
        )
    }
)
