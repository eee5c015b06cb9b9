"""Correction of a model parameter by an estimator, with fallback to the file's value.

Two lags in series, L = T/2 each, take the difference x of the parameter from the file to its estimate e, which has the
standard deviation s:

    estimate OK and not older than SILENCE    y' = w (e - y) / L,   w = 1 / (1 + (s / S)^2)
    otherwise                                 y' = -y / T_fallback
    always                                    x' = (y - x) / L

so that x = 0, the model of the file, is where x goes when the estimator is gone, warming up, not excited or doubts its
signals. An estimate with s = S has half weight; with w = 1 the filter is critically damped and T is its mean delay.
The lag of x never changes, so that x' is continuous when an estimate comes or goes: the torque has no kink.
e is clipped to [low, high], which contains 0. Each step makes y a convex combination of y with e or with 0, and x one
of x with y, hence

    low <= x <= high,   |x'| <= (high - low) / L,   |x''| <= (high - low) (2 / L + 1 / T_fallback) / L

for any estimates: neither x nor x' jumps, and no estimate moves x faster. For constant e it converges
exponentially at the rate w / L. Estimates come from equations of the plant that hold under any torque. x enters the
torque only, so that estimator and controller are a cascade and no loop in which both could diverge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import expm1, inf, isfinite

from via_core.status import Status

from via_controllers.contract import require, require_positive

SILENCE = 0.1  # [s] age from which an estimate is not used
LONGEST = 0.1  # [s] longest time step; after a longer gap this step is used
LARGEST_FACTOR = 3.0  # bound of the correction of a spring law, up or down
NOTHING = 1e-9  # smaller corrections are none, so that the fallback ends


@dataclass(frozen=True)
class Correction:
    """State of a corrected parameter."""

    value: float = 0.0  # x
    wanted: float = 0.0  # y
    estimate: float = 0.0  # e, clipped
    weight: float = 0.0  # w; 0: the last estimate was not OK
    stamp: float = -inf  # [s] of the last estimate


@dataclass(frozen=True)
class CorrectionRule:
    """The rule. Raises ParameterError for a time or standard deviation <= 0, or for bounds without 0 between them."""

    time: float  # T [s]
    fallback_time: float  # T_fallback [s]
    trusted_deviation: float  # S, in the unit of x
    low: float
    high: float

    def __post_init__(self) -> None:
        require_positive(self, "time", "fallback_time", "trusted_deviation")
        require(self.low <= 0.0 <= self.high, f"bounds must have 0 between them, got {self.low} and {self.high}")

    def informed(self, state: Correction, stamp: float, status: Status, value: float, sd: float) -> Correction:
        """`state` with the estimate e = `value` of standard deviation `sd` at `stamp` [s]; older ones are ignored."""
        if not isfinite(stamp) or stamp < state.stamp:
            return state
        if status != Status.OK or not (isfinite(value) and isfinite(sd) and sd >= 0.0):
            return replace(state, weight=0.0, stamp=stamp)
        weight = 1.0 / (1.0 + (sd / self.trusted_deviation) ** 2)
        return replace(state, estimate=min(max(value, self.low), self.high), weight=weight, stamp=stamp)

    def advanced(self, state: Correction, time: float, step: float) -> Correction:
        """`state` at `time` [s], `step` >= 0 [s] after the last call."""
        step, lag = min(step, LONGEST), 0.5 * self.time
        used = state.weight > 0.0 and abs(time - state.stamp) <= SILENCE
        towards, rate = (state.estimate, state.weight / lag) if used else (0.0, 1.0 / self.fallback_time)
        wanted = _lagged(state.wanted, towards, step * rate)
        value = _lagged(state.value, wanted, step / lag)
        if not used and max(abs(value), abs(wanted)) <= NOTHING:
            value = wanted = 0.0
        return replace(state, value=value, wanted=wanted)


def _lagged(value: float, towards: float, passed: float) -> float:
    """A first-order lag `passed` time constants later, under a constant input."""
    return value - expm1(-passed) * (towards - value)
