"""Whether the 95 % intervals of a report's parameters hold the true values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, pi
from typing import Any

from via_validation.sealed.rightness import Place, places

NORMAL = 1.96  # standard deviations to either side hold 95 % of a normal distribution
PERIODIC = ("torque_ripple", "encoder_eccentricity")  # sums of amplitude sin(order angle + phase)
SAME_ORDER = 0.25  # [1/rev] within which two terms are one


@dataclass(frozen=True)
class Inside:
    """One parameter: whether its interval holds the truth."""

    effect: str
    parameter: str
    holds: bool


def intervals_hold(
    truths: Iterable[Mapping[str, Any]], causes: Sequence[Mapping[str, Any]], repair: Sequence[Place], family: str
) -> tuple[Inside, ...]:
    """Every parameter of every true effect that the repair has at its place. Other effects have no interval to check.

    A parameter's interval is its `interval`, or its value and 1.96 of its `sd` to either side. Terms of a periodic
    effect are compared with the true term of the same order, a negative amplitude as a phase turned by half a period.
    A true term that the answer lacks is an interval that does not hold.
    """
    found: list[Inside] = []
    for truth in truths:
        place = Place(truth["effect"], truth["site"], truth["motor"])
        for cause in causes:
            here = Place(cause["effect"], cause["site"], int(cause.get("motor", 0)))
            if here.effect == place.effect and here in repair and places([here], place, family):
                found += _compared(place.effect, truth["parameters"], cause.get("parameters", {}))
                break
    return tuple(found)


def _compared(effect: str, true: Mapping[str, float], reported: Mapping[str, Any]) -> list[Inside]:
    if effect in PERIODIC:
        return _periodic(effect, true, reported)
    return [Inside(effect, name, _holds(reported[name], value)) for name, value in true.items() if name in reported]


def _periodic(effect: str, true: Mapping[str, float], reported: Mapping[str, Any]) -> list[Inside]:
    found = []
    for of in _terms(true):
        order = true.get(f"order{of}", 1.0)
        match = [at for at in _terms(reported) if abs(_value(reported.get(f"order{at}", 1.0)) - order) < SAME_ORDER]
        if not match:
            found.append(Inside(effect, "amplitude", False))
            continue
        (at, *_) = match
        amplitude, phase = true[f"amplitude{of}"], true[f"phase{of}"]
        if _value(reported[f"amplitude{at}"]) < 0.0:
            amplitude, phase = -amplitude, phase + pi
        if f"phase{at}" in reported:
            turns = round((_value(reported[f"phase{at}"]) - phase) / (2.0 * pi))
            found.append(Inside(effect, "phase", _holds(reported[f"phase{at}"], phase + 2.0 * pi * turns)))
        found.append(Inside(effect, "amplitude", _holds(reported[f"amplitude{at}"], amplitude)))
    return found


def _terms(parameters: Mapping[str, Any]) -> list[str]:
    """Endings of the names of a periodic effect's terms: '', '_2' ...; terms without amplitude are none."""
    names = [name.removeprefix("amplitude") for name in parameters if name.startswith("amplitude")]
    return [of for of in names if _value(parameters[f"amplitude{of}"]) != 0.0]


def _value(reported: Any) -> float:
    return float(reported["value"] if isinstance(reported, Mapping) else reported)


def _holds(reported: Any, value: float) -> bool:
    """Whether the interval holds a value; rounding of the report's numbers is no miss."""
    half = NORMAL * reported.get("sd", 0.0)
    low, high = reported.get("interval") or (reported["value"] - half, reported["value"] + half)
    slack = 1e-9 * hypot(low, high)
    return bool(low - slack <= value <= high + slack)
