"""The gap in numbers: before a repair, after it, and the least that can be reached."""

from __future__ import annotations

from typing import Literal

from via_gap.logs.findings import Number, Record


class SignalGap(Record):
    """Error of a simulated signal over the standard deviation of the measured one, on held-out data."""

    before: Number
    after: Number
    floor: Number
    ceiling: Number
    closes: Number


class Gap(Record):
    """The gap over all signals: root mean square of those of each.

    before    the device file as it stands
    tuned     its numbers moved inside their tolerance, no effect
    after     those numbers and the effects named
    interval  95 % of `after`, from resampled blocks
    floor     what the sensors alone leave
    ceiling   what is left by the best this diagnosis reaches: a flexible model of each equation, or the named effects
    closes    (before - after) / (before - ceiling)
    by        'shots': short runs from measured states; 'free run': one run over the whole log;
              'equations': torque that the link's equation lacks, against the drive's
    """

    by: Literal["shots", "free run", "equations"]
    before: Number
    tuned: Number
    after: Number
    interval: tuple[Number, Number]
    floor: Number
    ceiling: Number
    closes: Number
    signals: dict[str, SignalGap]
