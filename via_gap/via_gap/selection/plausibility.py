"""Plausibility of a fitted effect: significant size, and parameters inside their ranges."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2
from via_core.signals import Array

from via_gap.candidates.bounds import absences, bounds_of
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import size_of, size_parameters
from via_gap.residual.nuisance import BOUND, descend
from via_gap.selection.numbers import NUMBERS

EDGE = 1e-3  # of a parameter's typical size: closer to an end of its range it counts as at the end


def doubt(fit: Fit, scales: Scales) -> str:
    """Why the effects of a fit may not be named, in one phrase; empty if they may."""
    return _ruled_out(fit, scales, significant=True)


def absurd(fit: Fit, scales: Scales) -> str:
    """As `doubt`, but without the test of significance: at the end of a range, or absent; otherwise empty.

    On a subset, or before other effects are added, unexplained errors widen every interval.
    """
    return _ruled_out(fit, scales, significant=False)


def _ruled_out(fit: Fit, scales: Scales, significant: bool) -> str:
    """The first reason against a fit, in one phrase; with `significant`, sizes are tested against zero."""
    first = 0
    for location, effect in zip(fit.locations, fit.effects, strict=True):
        parameters = location.parameters
        own = slice(first, first + len(parameters))
        first += len(parameters)
        which = [i for i, p in enumerate(parameters) if p.name in size_parameters(location)]
        values = np.array([effect.parameters[p.name] for p in parameters])
        neutral = np.array([p.neutral for p in parameters])
        low, high = bounds_of(location, scales)
        edge = EDGE * np.array([size_of(p, location, scales) for p in parameters])
        absent = absences(location) & (low == -scales.friction[location.axis])
        at_end = (values >= high - edge) | ((values <= low + edge) & (low != neutral) & ~absent)
        # At an end it is a simpler effect: another one, itself without an optional parameter, or a part of a period,
        # which is any function of the angle.
        if location.kind.whole_period:
            more = _orders(location, values)
        else:
            more = [i for i, p in enumerate(parameters) if p.name in location.optional]
        limited = range(len(parameters)) if location.kind.contains else [*which, *more]
        for i in limited:
            if at_end[i]:
                return f"{location}: {parameters[i].name} is at the end of its range"
        if not np.any(values[which] != neutral[which]):
            return f"{location}: is absent"
        if significant:
            size, slopes = _size(location, values, neutral, which)
            if _may_be_zero(fit, own, size, slopes):
                return f"{location}: its size is consistent with zero"
            apart = _differences(location, len(parameters))
            if len(apart) and _may_be_zero(fit, own, apart @ values, apart):
                return f"{location}: is consistent with {location.plainest}"
    return ""


def _may_be_zero(fit: Fit, own: slice, size: Array, slopes: Array) -> bool:
    """Whether a size (k,) with slopes (k, p) is not significant."""
    return _distance(fit, own, size, slopes) < float(chi2.ppf(1.0 - NUMBERS.significance, len(size)))


def _distance(fit: Fit, own: slice, size: Array, slopes: Array) -> float:
    """Squared distance of a size (k,) with slopes (k, p) from 0, in standard deviations.

    Without the effect, the device parameters that it contains would be fitted up to the ends of their tolerances.
    """
    covariance = fit.covariance[own, own]
    if fit.tolerances.size:
        covariance = covariance - fit.tolerances[:, own].T @ fit.tolerances[:, own]
    information = np.linalg.pinv(slopes @ covariance @ slopes.T, hermitian=True)
    if fit.tolerances.size:
        moved, end = slopes @ fit.tolerances[:, own].T, np.full(len(fit.tolerances), BOUND)
        normal, gradient = moved.T @ information @ moved, moved.T @ information @ size
        size = size - moved @ descend(normal, gradient, np.zeros(len(end)), -end, end)
    return float(size @ information @ size)


def _differences(location: Location, count: int) -> Array:
    """(k, p) differences of `count` parameters that are zero in the simpler effect, whose value is their mean."""
    alike = location.kind.contains[1] if location.kind.contains else ()
    return np.eye(count)[list(alike[1:])] - np.eye(count)[list(alike[:1] * max(len(alike) - 1, 0))]


def _orders(location: Location, values: Array) -> list[int]:
    """Parameters that are the orders of harmonics with an amplitude."""
    units = [p.unit for p in location.parameters]
    return [i for i, unit in enumerate(units) if unit == "1/rev" and values[i - 1] != 0.0]


def _size(location: Location, values: Array, neutral: Array, which: list[int]) -> tuple[Array, Array]:
    """Distance of an effect from its absence (k,), and derivatives by its parameters (k, p)."""
    starts = location.kind.starts
    if location.kind.lever:
        mass, distance = values
        size = np.array([mass * distance, mass * distance**2])  # weight and inertia: the log may show one of them only
        return size, np.array([[distance, mass], [distance**2, 2.0 * mass * distance]])
    away = values[which] - neutral[which]
    slopes = np.eye(len(values))[which]
    if starts is not None and starts.limit:
        away = values[which]
    return away, slopes
