"""Initial parameter values of candidates at the typical sizes of a log, and typical sizes of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import atan2, copysign, hypot

import numpy as np
from via_core.devices import Device
from via_sim.catalogue.kinds import EffectParameter
from via_sim.catalogue.starts import Start, Typical

from via_gap.candidates.levers import bent, straightened
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales

Values = dict[str, float]


def starts(location: Location, scales: Scales, device: Device) -> tuple[Start, ...]:
    """All starts of a candidate; for both motors those of the first. Optional parameters are neutral.

    An effect that states no starts begins at a tenth of the typical sizes.
    """
    parameters = location.parameters

    def whole(given: Values) -> Values:
        return {p.name: float(np.clip(given.get(p.name, p.neutral), p.low, p.high)) for p in parameters}

    torque, speed = _typical(scales, location, location.axis)
    here = Typical(
        device, torque, speed, float(scales.peak[max(location.axis, 1) - 1]), scales.slew, scales.angle, scales.range,
        scales.deflection, scales.stretch, scales.duration, scales.busy, scales.orders[location.axis],
    )  # fmt: skip
    if location.kind.starts is not None:
        made = location.kind.starts.made(here)
    else:
        tenth = {p.name: p.neutral + 0.1 * size_of(p, location, scales) for p in parameters}
        made = [Start((tenth,), size_parameters(location))]
    return tuple(replace(start, directions=tuple(map(whole, start.directions))) for start in made)


def shapes(location: Location, values: Sequence[float], scales: Scales, device: Device) -> list[list[float]]:
    """An effect of the same size with the nonlinear parameters of each of its starts."""
    found: list[list[float]] = []
    for start in starts(location, scales, device):
        linear = {*start.scaled, *start.through, *(("amplitude", "phase") if start.wave else ())}
        pairs = zip(location.parameters, values, strict=True)
        shape = [value if p.name in linear else start.directions[0][p.name] for p, value in pairs]
        if shape not in (*found, list(values)):
            found.append(shape)
    return found


def size_parameters(location: Location) -> tuple[str, ...]:
    """Names of the size parameters of an effect: at their neutral values it is absent."""
    if location.kind.starts is not None:
        return location.kind.starts.sizes
    names = tuple(p.name for p in location.parameters if p.linear)
    return names or tuple(p.name for p in location.parameters)


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
    if location.kind.lever:
        acting = [straightened(np.array([d["mass"], d["distance"]]), (0,)) for d in start.directions]
        values["mass"], values["distance"] = map(float, bent(np.asarray(amounts) @ acting, (0,)))
    if start.about:
        along, across, sign = start.about + values["torque"], start.about * values["angle"], copysign(1.0, start.about)
        values["torque"] = sign * hypot(along, across) - start.about
        values["angle"] = atan2(sign * across, sign * along)
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
        "1/rad^2": 1.0 / scales.stretch**2,
        "1/s": 1.0 / scales.duration,
        "kg m^2": 0.0,
        "1/rev": 1.0,
        "m": 0.1,
        "s": scales.duration if parameter.high > 10.0 else 0.02,
    }
    size = sizes.get(parameter.unit) or 1.0
    if location.kind.starts is not None and location.kind.starts.of_peak:
        size = float(scales.peak[max(axis, 1) - 1]) or size
    if parameter.unit == "kg m^2":
        size = torque / max(speed * 10.0, 1e-6)
    return float(min(size, parameter.high - parameter.low))


def _typical(scales: Scales, location: Location, axis: int) -> tuple[float, float]:
    """Torque [N m] and speed [rad/s] at a location; a transmission transmits at least the torque on the link."""
    torque, speed = float(scales.torque[axis]), float(scales.speed[axis])
    return (max(torque, float(scales.torque[0])), speed) if location.site == "transmission" else (torque, speed)
