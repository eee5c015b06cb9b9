"""Whether the 95 % intervals of a report's parameters contain the true values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, pi
from typing import Any

from via_validation.sealed.rightness import Cause, locates

NORMAL = 1.96  # standard deviations on either side that contain 95 % of a normal distribution
PERIODIC = ("torque_ripple", "encoder_eccentricity")  # sums of amplitude sin(order angle + phase)
SAME_ORDER = 0.25  # [1/rev] terms closer than this are the same term


@dataclass(frozen=True)
class IntervalCheck:
    """Whether the interval of one parameter contains the true value."""

    effect: str
    parameter: str
    holds: bool


def intervals_hold(
    truths: Iterable[Mapping[str, Any]], causes: Sequence[Mapping[str, Any]], repair: Sequence[Cause], family: str
) -> tuple[IntervalCheck, ...]:
    """Checks of all parameters of the true effects that the repair contains at the right location.

    Effects elsewhere have no interval to check. A parameter's interval is its `interval`, or its value +- 1.96 `sd`.
    Terms of a periodic effect are compared with the true term of the same order; a negative amplitude counts as a phase
    shift of half a period. If the answer lacks a true term, its interval counts as wrong.
    """
    found: list[IntervalCheck] = []
    for truth in truths:
        true = Cause(truth["effect"], truth["site"], truth["motor"])
        for cause in causes:
            named = Cause(cause["effect"], cause["site"], int(cause.get("motor", 0)))
            if named.effect == true.effect and named in repair and locates([named], true, family):
                found += _compared(true.effect, truth["parameters"], cause.get("parameters", {}))
                break
    return tuple(found)


def _compared(effect: str, true: Mapping[str, float], reported: Mapping[str, Any]) -> list[IntervalCheck]:
    if effect in PERIODIC:
        return _periodic(effect, true, reported)
    return [
        IntervalCheck(effect, name, _holds(reported[name], value)) for name, value in true.items() if name in reported
    ]


def _periodic(effect: str, true: Mapping[str, float], reported: Mapping[str, Any]) -> list[IntervalCheck]:
    found = []
    for term in _terms(true):
        order = true.get(f"order{term}", 1.0)
        match = [
            each for each in _terms(reported) if abs(_value(reported.get(f"order{each}", 1.0)) - order) < SAME_ORDER
        ]
        if not match:
            found.append(IntervalCheck(effect, "amplitude", False))
            continue
        (same, *_) = match
        amplitude, phase = true[f"amplitude{term}"], true[f"phase{term}"]
        if _value(reported[f"amplitude{same}"]) < 0.0:
            amplitude, phase = -amplitude, phase + pi
        if f"phase{same}" in reported:
            turns = round((_value(reported[f"phase{same}"]) - phase) / (2.0 * pi))
            found.append(IntervalCheck(effect, "phase", _holds(reported[f"phase{same}"], phase + 2.0 * pi * turns)))
        found.append(IntervalCheck(effect, "amplitude", _holds(reported[f"amplitude{same}"], amplitude)))
    return found


def _terms(parameters: Mapping[str, Any]) -> list[str]:
    """Suffixes of the parameter names of a periodic effect's terms ('', '_2', ...), without terms of amplitude 0."""
    names = [name.removeprefix("amplitude") for name in parameters if name.startswith("amplitude")]
    return [name for name in names if _value(parameters[f"amplitude{name}"]) != 0.0]


def _value(reported: Any) -> float:
    return float(reported["value"] if isinstance(reported, Mapping) else reported)


def _holds(reported: Any, value: float) -> bool:
    """Whether the interval contains a value, with slack for the rounding of the report's numbers."""
    half = NORMAL * reported.get("sd", 0.0)
    low, high = reported.get("interval") or (reported["value"] - half, reported["value"] + half)
    slack = 1e-9 * hypot(low, high)
    return bool(low - slack <= value <= high + slack)
