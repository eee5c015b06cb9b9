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

    def whole(given: Values) -> Values:
        return {p.name: float(np.clip(given.get(p.name, p.neutral), p.low, p.high)) for p in parameters}

    made = _starts_of(location).made(_Here(scales, location, device))
    return tuple(replace(start, directions=tuple(map(whole, start.directions))) for start in made)


def size_parameters(location: Location) -> tuple[str, ...]:
    """Names of the size parameters of an effect: at their neutral values it is absent."""
    return _starts_of(location).sizes


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
        low, high = (-reach, reach) if start.wave or start.scaled else (1.0, 1.0)
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


def _typical(scales: Scales, location: Location, axis: int) -> tuple[float, float]:
    """Torque [N m] and speed [rad/s] at a location; a transmission transmits at least the torque on the link."""
    torque, speed = float(scales.torque[axis]), float(scales.speed[axis])
    return (max(torque, float(scales.torque[0])), speed) if location.site == "transmission" else (torque, speed)


@dataclass(frozen=True)
class _Here:
    """What the starts of an effect at a location are relative to."""

    scales: Scales
    location: Location
    device: Device

    @property
    def torque(self) -> float:
        return _typical(self.scales, self.location, self.location.axis)[0]

    @property
    def speed(self) -> float:
        return _typical(self.scales, self.location, self.location.axis)[1]


@dataclass(frozen=True)
class _Starts:
    """Starts of one effect, and the names of its size parameters."""

    sizes: tuple[str, ...]
    made: Callable[[_Here], list[Start]]


def _starts_of(location: Location) -> _Starts:
    """The starts of an effect. One that was added to the catalogue starts at a tenth of the typical sizes."""
    if location.name in _STARTS:
        return _STARTS[location.name]
    parameters = location.parameters
    sizes = tuple(p.name for p in parameters if p.linear) or tuple(p.name for p in parameters)
    return _grid(
        *sizes, at=lambda h: [{p.name: p.neutral + 0.1 * size_of(p, h.location, h.scales) for p in parameters}]
    )


def _one(**values: Callable[[_Here], float]) -> _Starts:
    """One direction, of these size parameters together."""
    return _grid(*values, at=lambda here: [{name: value(here) for name, value in values.items()}])


def _each(**values: Callable[[_Here], float]) -> _Starts:
    """A direction for each of these size parameters."""
    names = tuple(values)
    return _Starts(names, lambda here: [Start(tuple({name: value(here)} for name, value in values.items()), names)])


def _grid(*sizes: str, at: Callable[[_Here], list[Values]], through: tuple[str, ...] = ()) -> _Starts:
    """Starts with one direction each, proportional to the size parameters `sizes`."""
    return _Starts(sizes, lambda here: [Start((values,), sizes, through=through) for values in at(here)])


def _limits(at: Callable[[_Here], list[float]]) -> _Starts:
    """Limits on which nothing depends linearly."""
    return _Starts(("limit",), lambda here: [Start(({"limit": limit},), ()) for limit in at(here)])


def _waves(at: Callable[[_Here], list[Values]]) -> _Starts:
    """Sines and cosines with these amplitudes and orders."""
    both = (0.0, 0.5 * pi)
    return _Starts(
        ("amplitude",),
        lambda here: [Start(tuple({**wave, "phase": phase} for phase in both), (), True) for wave in at(here)],
    )


def _sliding(ways: Callable[[_Here], list[float]]) -> _Starts:
    """An element that slips after `ways` [rad]; torque and stiffness are scaled together, so that way is constant."""

    def values(here: _Here) -> list[Values]:
        return [{"torque": 0.1 * here.torque, "stiffness": 0.1 * here.torque / way} for way in ways(here)]

    return _grid("torque", at=values, through=("stiffness",))


def _saturation(here: _Here) -> list[float]:
    if here.device.drive == "servo":
        return [share * here.scales.slew for share in (0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)]
    peak = float(here.scales.peak[max(here.location.axis, 1) - 1])
    return [share * peak for share in (0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96, 0.985)]


def _payload(here: _Here) -> list[Values]:
    link, distance = here.device.link, 0.2
    if link.gravity_torque != 0.0:
        distance = min(max(9.81 * link.inertia / abs(link.gravity_torque), 0.02), 1.0)
    return [{"mass": 0.2 * link.inertia / distance**2, "distance": distance}]


def _contact(here: _Here) -> list[Values]:
    stiffness = 2.0 * here.torque / here.scales.angle
    low, tenth, ninetieth, high = (float(each) for each in here.scales.range)
    walls = ((high, 1.0), (ninetieth, 1.0), (tenth, -1.0), (low, -1.0))
    return [{"angle": angle, "stiffness": stiffness, "damping": 0.0, "side": side} for angle, side in walls]


def _external(here: _Here) -> list[Values]:
    torque, edges = 0.1 * here.torque, np.linspace(0.0, here.scales.duration, EDGES)
    spans = [*here.scales.busy, *((a, b) for i, a in enumerate(edges) for b in edges[i + 1 :])]
    return [*({"torque": torque, "start": float(a), "stop": float(b)} for a, b in spans), {"torque": torque}]


_STARTS: Mapping[str, _Starts] = {
    "coulomb_friction": _one(torque=lambda h: 0.1 * h.torque),
    "asymmetric_coulomb": _each(forward=lambda h: 0.1 * h.torque, backward=lambda h: 0.1 * h.torque),
    "stribeck_friction": _grid("breakaway", "kinetic", at=lambda h: [
        {"breakaway": 0.2 * h.torque, "kinetic": 0.1 * h.torque, "velocity": share * h.speed}
        for share in (0.03, 0.12, 0.4)
    ]),
    "viscous_friction": _one(coefficient=lambda h: 0.1 * h.torque / h.speed),
    "asymmetric_viscous": _each(
        forward=lambda h: 0.1 * h.torque / h.speed, backward=lambda h: 0.1 * h.torque / h.speed
    ),
    "quadratic_drag": _one(coefficient=lambda h: 0.1 * h.torque / h.speed**2),
    "presliding_friction": _sliding(lambda h: [share * h.scales.angle for share in (0.01, 0.05, 0.2)]),
    "load_dependent_friction": _grid(
        "coefficient", "counter_coefficient", "stribeck", "counter_stribeck", "quadratic",
        at=lambda _h: [{"coefficient": 0.05}],
    ),
    "backlash": _one(gap=lambda h: 0.2 * h.scales.deflection),
    "hysteresis": _sliding(lambda h: [share * h.scales.deflection for share in (0.05, 0.2, 0.8)]),
    "spring_damping": _one(coefficient=lambda h: 0.1 * h.torque / h.speed),
    "spring_law": _each(scale=lambda _h: 1.1, hardening=lambda h: 0.1 / h.scales.deflection**2),
    "stiffness_drift": _one(rate=lambda h: 0.1 / h.scales.duration),
    "preset_error": _one(offset=lambda h: 0.1 * h.scales.deflection),
    "joint_coupling": _one(stiffness=lambda h: 0.1 * h.torque),
    "torque_gain": _one(gain=lambda _h: 1.05),
    "torque_bias": _one(torque=lambda h: 0.1 * h.torque),
    "torque_ripple": _waves(lambda h: [
        {"amplitude": 0.1 * h.torque, "order": order} for order in h.scales.orders[h.location.axis]
    ]),
    "torque_saturation": _limits(_saturation),
    "actuator_lag": _one(time_constant=lambda _h: 0.004),
    "actuator_delay": _grid("delay", at=lambda _h: [{"delay": 0.004}, {"delay": 0.03}]),
    "speed_limit": _limits(lambda h: [share * h.scales.slew for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.2)]),
    "encoder_offset": _grid("offset", at=lambda _h: [{"offset": offset} for offset in OFF]),
    "encoder_eccentricity": _waves(lambda _h: [{"amplitude": size} for size in OFF]),
    "channel_skew": _grid("delay", at=lambda _h: [{"delay": 0.002}, {"delay": 0.015}]),
    "payload": _grid("mass", at=_payload),
    "link_inertia": _one(inertia=lambda h: 0.1 * h.device.link.inertia),
    "gravity_error": _each(torque=lambda h: 0.1 * h.torque, angle=lambda _h: 0.05),
    "contact": _grid("stiffness", at=_contact),
    "external_torque": _grid("torque", at=_external),
}  # fmt: skip
