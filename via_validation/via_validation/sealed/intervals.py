"""How far true values lie from a report's parameters, in half-widths of their 95 % intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, pi
from typing import Any

from via_core.metrics import WIDTH_95

from via_validation.sealed.rightness import Cause, locates

SAME_ORDER = 0.25  # [1/rev] terms closer than this are the same term


@dataclass(frozen=True)
class IntervalCheck:
    """Distance of a true value from its reported one, over half the interval; infinite if it was not reported."""

    effect: str
    parameter: str
    distance: float

    @property
    def holds(self) -> bool:
        """Whether the interval contains the true value."""
        return self.distance <= 1.0


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
    if "amplitude" in true:  # a sum of amplitude sin(order angle + phase)
        return _periodic(effect, true, reported)
    return [
        IntervalCheck(effect, name, _distance(reported[name], value))
        for name, value in true.items()
        if name in reported
    ]


def _periodic(effect: str, true: Mapping[str, float], reported: Mapping[str, Any]) -> list[IntervalCheck]:
    found = []
    for term in _terms(true):
        order = true.get(f"order{term}", 1.0)
        match = [
            each for each in _terms(reported) if abs(_value(reported.get(f"order{each}", 1.0)) - order) < SAME_ORDER
        ]
        if not match:
            found.append(IntervalCheck(effect, "amplitude", inf))
            continue
        (same, *_) = match
        amplitude, phase = true[f"amplitude{term}"], true[f"phase{term}"]
        if _value(reported[f"amplitude{same}"]) < 0.0:
            amplitude, phase = -amplitude, phase + pi
        if f"phase{same}" in reported:
            turns = round((_value(reported[f"phase{same}"]) - phase) / (2.0 * pi))
            found.append(IntervalCheck(effect, "phase", _distance(reported[f"phase{same}"], phase + 2.0 * pi * turns)))
        found.append(IntervalCheck(effect, "amplitude", _distance(reported[f"amplitude{same}"], amplitude)))
    return found


def _terms(parameters: Mapping[str, Any]) -> list[str]:
    """Suffixes of the parameter names of a periodic effect's terms ('', '_2', ...), without terms of amplitude 0."""
    names = [name.removeprefix("amplitude") for name in parameters if name.startswith("amplitude")]
    return [name for name in names if _value(parameters[f"amplitude{name}"]) != 0.0]


def _value(reported: Any) -> float:
    return float(reported["value"] if isinstance(reported, Mapping) else reported)


def _distance(reported: Any, value: float) -> float:
    """Distance of a value from the reported one over half the interval, less the rounding of the report's numbers."""
    half = WIDTH_95 * reported.get("sd", 0.0)
    low, high = reported.get("interval") or (reported["value"] - half, reported["value"] + half)
    half = high - reported["value"] if value > reported["value"] else reported["value"] - low
    apart = max(abs(value - reported["value"]) - 1e-9 * hypot(low, high), 0.0)
    return float(apart / half) if half > 0.0 else (inf if apart > 0.0 else 0.0)
