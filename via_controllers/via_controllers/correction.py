"""Correction of a model parameter by an estimator, with fallback to the file's value.

x is the difference of the parameter from the file, e its estimate with standard deviation s:

    estimate OK and not older than SILENCE    x' = w (e - x) / T,   w = 1 / (1 + (s / S)^2)
    otherwise                                 x' = -x / T_fallback

so that x = 0, the model of the file, is where x goes when the estimator is gone, warming up, not excited or doubts its
signals. An estimate with s = S has half weight. e is clipped to [low, high], which contains 0. Each step is a convex
combination of x with e or with 0, hence

    low <= x <= high   and   |x'| <= (high - low) / min(T, T_fallback)

whatever the estimator says: x is bounded and never jumps, and no estimate moves it faster. For constant e it converges
exponentially at the rate w / T. Estimates come from equations of the plant that hold under any torque. x enters the
torque only, so that estimator and controller are a cascade and no loop in which both could diverge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, inf, isfinite

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
        return Correction(state.value, min(max(value, self.low), self.high), weight, stamp)

    def advanced(self, state: Correction, time: float, step: float) -> Correction:
        """`state` at `time` [s], `step` >= 0 [s] after the last call."""
        step = min(step, LONGEST)
        used = state.weight > 0.0 and abs(time - state.stamp) <= SILENCE
        if not used and state.value == 0.0:
            return state
        rate, towards = (state.weight / self.time, state.estimate) if used else (1.0 / self.fallback_time, 0.0)
        kept = exp(-step * rate)
        value = kept * state.value + (1.0 - kept) * towards
        return Correction(value if abs(value) > NOTHING else 0.0, state.estimate, state.weight, state.stamp)
