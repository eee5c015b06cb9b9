"""Initial parameter values of each effect, and typical sizes of its parameters.

A start is one or more directions: parameter sets that can be scaled and added, as far as the effect is linear in them.
Nonlinear parameters (a speed, an order, the place of a wall) have a small grid of starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, hypot, pi

import numpy as np
from via_core.devices import Device
from via_sim.effects.catalogue import EffectParameter

from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales

Values = dict[str, float]
OFF = (0.01, 0.1)  # [rad] errors of an encoder: the first has an influence through springs, the second through gravity
EDGES = 7  # grid of beginnings and ends of an external torque


@dataclass(frozen=True)
class Start:
    """directions  sets of all parameters of the effect
    scaled      names whose distance from neutral is proportional to the amount; others keep the first direction's value
    wave        whether the directions are sine and cosine of `phase` with one `amplitude`
    through     names whose value is proportional to the amount, whatever the neutral value
    """

    directions: tuple[Values, ...]
    scaled: tuple[str, ...]
    wave: bool = False
    through: tuple[str, ...] = ()


def starts(location: Location, scales: Scales, device: Device) -> tuple[Start, ...]:
    """All starts of a candidate; for both motors those of the first. Optional parameters are neutral."""
    parameters = location.parameters
    made = _STARTS[location.name](_Here(scales, location.axis, location, device))
    clipped = []
    for start in made:
        directions = tuple(
            {p.name: float(np.clip(d.get(p.name, p.neutral), p.low, p.high)) for p in parameters}
            for d in start.directions
        )
        clipped.append(replace(start, directions=directions))
    return tuple(clipped)


def size_parameters(location: Location) -> tuple[str, ...]:
    """Names of the size parameters of an effect: at their neutral values it is absent."""
    named = _SIZES.get(location.name)
    return named or tuple(p.name for p in location.parameters if p.linear)


def combined(location: Location, start: Start, amounts: Sequence[float]) -> list[float]:
    """Parameter values, in their order, of a start with these amounts of its directions."""
    parameters = location.parameters
    first = start.directions[0]
    values = dict(first)
    if start.wave:
        sine, cosine = amounts
        values["amplitude"] = first["amplitude"] * hypot(sine, cosine)
        values["phase"] = atan2(cosine, sine)
    else:
        for p in parameters:
            if p.name in start.scaled:
                values[p.name] = p.neutral + sum(
                    a * (d[p.name] - p.neutral) for a, d in zip(amounts, start.directions, strict=True)
                )
            elif p.name in start.through:
                values[p.name] = amounts[0] * first[p.name]
    return [float(np.clip(values[p.name], p.low, p.high)) for p in parameters]


def amount_range(location: Location, start: Start, reach: float) -> tuple[list[float], list[float]]:
    """Least and largest amounts of each direction within the effect's bounds and +-reach."""
    lows, highs = [], []
    for direction in start.directions:
        low, high = (-reach, reach) if start.wave else ((1.0, 1.0) if not start.scaled else (-reach, reach))
        if not start.wave:
            for p in location.parameters:
                step = direction[p.name] - p.neutral
                if p.name in start.scaled and step != 0.0:
                    ends = sorted(((p.low - p.neutral) / step, (p.high - p.neutral) / step))
                    low, high = max(low, ends[0]), min(high, ends[1])
        lows.append(low)
        highs.append(high)
    return lows, highs


def size_of(parameter: EffectParameter, location: Location, scales: Scales) -> float:
    """Typical size of a parameter, in its unit."""
    axis = location.axis if location.site in ("motor", "transmission") else 0
    torque, speed = _typical(scales, location, axis)
    sizes = {
        "N m": torque,
        "rad": scales.deflection if location.site == "transmission" else scales.angle,
        "rad/s": speed,
        "N m s/rad": torque / speed,
        "N m s^2/rad^2": torque / speed**2,
        "N m/rad": torque / scales.deflection,
        "1/rad^2": 1.0 / scales.deflection**2,
        "1/s": 1.0 / scales.duration,
        "kg m^2": 0.0,
        "1/rev": 1.0,
        "m": 0.1,
        "s": scales.duration if parameter.high > 10.0 else 0.02,
    }
    size = sizes.get(parameter.unit) or 1.0
    if location.name == "torque_saturation":
        size = float(scales.peak[max(axis, 1) - 1]) or size
    if parameter.unit == "kg m^2":
        size = torque / max(speed * 10.0, 1e-6)
    return float(min(size, parameter.high - parameter.low))


@dataclass(frozen=True)
class _Here:
    scales: Scales
    axis: int
    location: Location
    device: Device

    @property
    def torque(self) -> float:
        return _typical(self.scales, self.location, self.axis)[0]

    @property
    def speed(self) -> float:
        return _typical(self.scales, self.location, self.axis)[1]


def _typical(scales: Scales, location: Location, axis: int) -> tuple[float, float]:
    """Torque [N m] and speed [rad/s] at a location; a transmission transmits at least the torque on the link."""
    torque, speed = float(scales.torque[axis]), float(scales.speed[axis])
    return (max(torque, float(scales.torque[0])), speed) if location.site == "transmission" else (torque, speed)


def _one(values: Callable[[_Here], Values], *scaled: str) -> Callable[[_Here], list[Start]]:
    return lambda here: [Start((values(here),), scaled)]


def _each(first: Callable[[_Here], Values], second: Callable[[_Here], Values]) -> Callable[[_Here], list[Start]]:
    def made(here: _Here) -> list[Start]:
        a, b = first(here), second(here)
        return [Start((a, b), tuple(dict.fromkeys([*a, *b])))]

    return made


def _stribeck(here: _Here) -> list[Start]:
    small, speeds = 0.1 * here.torque, (0.03, 0.12, 0.4)
    return [
        Start(({"breakaway": 2.0 * small, "kinetic": small, "velocity": share * here.speed},), ("breakaway", "kinetic"))
        for share in speeds
    ]


def _presliding(here: _Here) -> list[Start]:
    torque = 0.1 * here.torque
    ways = [share * here.scales.angle for share in (0.01, 0.05, 0.2)]
    return [_sliding(torque, way) for way in ways]


def _hysteresis(here: _Here) -> list[Start]:
    torque = 0.1 * here.torque
    ways = [share * here.scales.deflection for share in (0.05, 0.2, 0.8)]
    return [_sliding(torque, way) for way in ways]


def _sliding(torque: float, way: float) -> Start:
    """An element that slips after `way` [rad]; torque and stiffness are scaled together, so that `way` is constant."""
    return Start(({"torque": torque, "stiffness": torque / way},), ("torque",), through=("stiffness",))


def _ripple(here: _Here) -> list[Start]:
    amplitude = 0.1 * here.torque
    return [
        Start(tuple({"amplitude": amplitude, "order": order, "phase": phase} for phase in (0.0, 0.5 * pi)), (), True)
        for order in here.scales.orders[here.axis]
    ]


def _offset(_here: _Here) -> list[Start]:
    return [Start(({"offset": offset},), ("offset",)) for offset in OFF]


def _eccentricity(_here: _Here) -> list[Start]:
    return [Start(tuple({"amplitude": size, "phase": phase} for phase in (0.0, 0.5 * pi)), (), True) for size in OFF]


def _saturation(here: _Here) -> list[Start]:
    servo = here.device.drive == "servo"
    peak = here.scales.slew if servo else float(here.scales.peak[max(here.axis, 1) - 1])
    shares = (0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96, 0.985)
    if servo:
        shares = (0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)
    return [Start(({"limit": share * peak},), ()) for share in shares]


def _goal_speed(here: _Here) -> list[Start]:
    shares = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.2)
    return [Start(({"limit": share * here.scales.slew},), ()) for share in shares]


def _delays(*each: float) -> Callable[[_Here], list[Start]]:
    return lambda _here: [Start(({"delay": delay},), ("delay",)) for delay in each]


def _payload(here: _Here) -> list[Start]:
    distance = 0.2
    mass = 0.2 * here.device.link.inertia / distance**2
    if here.device.link.gravity_torque != 0.0:
        distance = min(max(9.81 * here.device.link.inertia / abs(here.device.link.gravity_torque), 0.02), 1.0)
        mass = 0.2 * here.device.link.inertia / distance**2
    return [Start(({"mass": mass, "distance": distance},), ("mass",))]


def _contact(here: _Here) -> list[Start]:
    stiffness = 2.0 * here.torque / here.scales.angle
    low, tenth, ninetieth, high = (float(each) for each in here.scales.range)
    return [
        Start(({"angle": angle, "stiffness": stiffness, "damping": 0.0, "side": side},), ("stiffness",))
        for angle, side in ((high, 1.0), (ninetieth, 1.0), (tenth, -1.0), (low, -1.0))
    ]


def _external(here: _Here) -> list[Start]:
    whole = Start(({"torque": 0.1 * here.torque},), ("torque",))
    edges = np.linspace(0.0, here.scales.duration, EDGES)
    spans = [*here.scales.busy, *((a, b) for i, a in enumerate(edges) for b in edges[i + 1 :])]
    parts = [
        Start(({"torque": 0.1 * here.torque, "start": float(begin), "stop": float(end)},), ("torque",))
        for begin, end in spans
    ]
    return [*parts, whole]


_STARTS: Mapping[str, Callable[[_Here], list[Start]]] = {
    "coulomb_friction": _one(lambda h: {"torque": 0.1 * h.torque}, "torque"),
    "asymmetric_coulomb": _each(lambda h: {"forward": 0.1 * h.torque}, lambda h: {"backward": 0.1 * h.torque}),
    "stribeck_friction": _stribeck,
    "viscous_friction": _one(lambda h: {"coefficient": 0.1 * h.torque / h.speed}, "coefficient"),
    "asymmetric_viscous": _each(
        lambda h: {"forward": 0.1 * h.torque / h.speed}, lambda h: {"backward": 0.1 * h.torque / h.speed}
    ),
    "quadratic_drag": _one(lambda h: {"coefficient": 0.1 * h.torque / h.speed**2}, "coefficient"),
    "presliding_friction": _presliding,
    "load_dependent_friction": _one(lambda _h: {"coefficient": 0.05}, "coefficient"),
    "backlash": _one(lambda h: {"gap": 0.2 * h.scales.deflection}, "gap"),
    "hysteresis": _hysteresis,
    "spring_damping": _one(lambda h: {"coefficient": 0.1 * h.torque / h.speed}, "coefficient"),
    "spring_law": _each(lambda _h: {"scale": 1.1}, lambda h: {"hardening": 0.1 / h.scales.deflection**2}),
    "stiffness_drift": _one(lambda h: {"rate": 0.1 / h.scales.duration}, "rate"),
    "preset_error": _one(lambda h: {"offset": 0.1 * h.scales.deflection}, "offset"),
    "joint_coupling": _one(lambda h: {"stiffness": 0.1 * h.torque}, "stiffness"),
    "torque_gain": _one(lambda _h: {"gain": 1.05}, "gain"),
    "torque_bias": _one(lambda h: {"torque": 0.1 * h.torque}, "torque"),
    "torque_ripple": _ripple,
    "torque_saturation": _saturation,
    "actuator_lag": _one(lambda _h: {"time_constant": 0.004}, "time_constant"),
    "actuator_delay": _delays(0.004, 0.03),
    "speed_limit": _goal_speed,
    "encoder_offset": _offset,
    "encoder_eccentricity": _eccentricity,
    "channel_skew": _delays(0.002, 0.015),
    "payload": _payload,
    "link_inertia": _one(lambda h: {"inertia": 0.1 * h.device.link.inertia}, "inertia"),
    "gravity_error": _each(lambda h: {"torque": 0.1 * h.torque}, lambda _h: {"angle": 0.05}),
    "contact": _contact,
    "external_torque": _external,
}

_SIZES: Mapping[str, tuple[str, ...]] = {  # size parameters, if they are not those marked as linear
    "presliding_friction": ("torque",),
    "hysteresis": ("torque",),
    "backlash": ("gap",),
    "spring_law": ("scale", "hardening"),
    "stiffness_drift": ("rate",),
    "preset_error": ("offset",),
    "torque_gain": ("gain",),
    "torque_ripple": ("amplitude",),
    "torque_saturation": ("limit",),
    "actuator_lag": ("time_constant",),
    "actuator_delay": ("delay",),
    "speed_limit": ("limit",),
    "channel_skew": ("delay",),
    "encoder_offset": ("offset",),
    "encoder_eccentricity": ("amplitude",),
    "payload": ("mass",),
    "link_inertia": ("inertia",),
    "gravity_error": ("torque", "angle"),
    "contact": ("stiffness",),
}
