"""Finds samples that are answered so late that their torques do not act.

Drivers ignore a command that is older than their watchdog. If a controller falls behind its samples, its torques
therefore end although it continues to send them, and the motors stop: this is no stall. The delay between measurement
and answer is not known, since the clocks of robot and controller may differ, but its change is:

    late = arrival - stamp - least > LATEST,   least = min(arrival - stamp) so far

`least` may change by DRIFT, because clocks drift. A sample with a still smaller difference shows that those before were
late; while a queue is worked off each sample is such. After a stamp that goes backward `least` starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

LATEST = 0.02  # [s] watchdog of drivers and simulators
DRIFT = 1e-3  # [s/s] of two clocks, at most


@dataclass(frozen=True)
class Lateness:
    """State after a sample."""

    least: float = inf  # [s] smallest arrival minus stamp
    stamp: float = -inf  # [s] of the last sample
    arrival: float = 0.0  # [s] of the last sample

    def step(self, stamp: float, arrival: float) -> tuple[Lateness, bool]:
        """The next state, and whether torques for the sample act; both times [s], each of its own clock."""
        difference, drift = arrival - stamp, DRIFT * (arrival - self.arrival)
        before = self.least if stamp >= self.stamp else inf
        acts = before - drift <= difference <= before + drift + LATEST
        return Lateness(min(difference, before + drift), stamp, arrival), acts
