"""Finds samples that are answered so late that their torques do not act.

Drivers ignore a command that is older than their watchdog. If a controller falls behind its samples, its torques
therefore end although it continues to send them, and the motors stop: this is no stall. The delay between measurement
and answer is not known, since the clocks of robot and controller may differ, but its change is:

    late = arrival - stamp - least > LATEST,   least = min(arrival - stamp) so far

`least` rises by DRIFT, because clocks drift. It falls a little whenever a message arrives faster than all before. A
fall by FALL shows that a queue is worked off, whose samples were late: torques count as late until CALM after the last
one. After a stamp that goes backward `least` starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

LATEST = 0.02  # [s] watchdog of drivers and simulators
FALL = 0.25 * LATEST  # [s], more than the arrivals of a network vary in general
CALM = 0.03  # [s]: a queue whose samples are answered at 1.2 times their rate or faster falls by FALL within it
DRIFT = 1e-3  # [s/s] of two clocks, at most


@dataclass(frozen=True)
class Lateness:
    """State after a sample."""

    least: float = inf  # [s] smallest arrival minus stamp
    level: float = inf  # [s] `least` after its last fall by FALL
    fell: float = -inf  # [s] arrival of the sample with this fall
    stamp: float = -inf  # [s] of the last sample
    arrival: float = 0.0  # [s] of the last sample

    def step(self, stamp: float, arrival: float) -> tuple[Lateness, bool]:
        """The next state, and whether torques for the sample act; both times [s], each of its own clock."""
        difference = arrival - stamp
        if stamp < self.stamp or self.least == inf:
            return Lateness(difference, difference, -inf, stamp, arrival), True
        least = min(difference, self.least + DRIFT * (arrival - self.arrival))
        level, fell = max(self.level, least), self.fell
        if least < level - FALL:
            level, fell = least, arrival
        acts = difference <= least + LATEST and arrival - fell >= CALM
        return Lateness(least, level, fell, stamp, arrival), acts
