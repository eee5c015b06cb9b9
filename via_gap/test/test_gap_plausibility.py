"""What may not be named: an effect at the end of its range, one that is absent, one that data do not tell from nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_gap.candidates.fit import Fit, bounds_of
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales, scales_of
from via_gap.residual.equations import weak_residuals
from via_gap.residual.segments import cut_log
from via_gap.selection.plausibility import doubt

NOTHING = np.empty(0)
COULOMB = Location("coulomb_friction", "motor", 1)
PAYLOAD = Location("payload", "link", 0)
GAIN = Location("torque_gain", "motor", 1)
RIPPLE = Location("torque_ripple", "motor", 1)
LIMIT = Location("torque_saturation", "motor", 1)


@cache
def scales() -> Scales:
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    every = np.arange(len(segments))
    return scales_of(
        [segments], [weak_residuals(segments, log.device)], segments.time[every], np.ones(len(segments))
    )


def fit(covariance: np.ndarray, **values: float) -> Fit:
    """Of the location whose parameters `values` are."""
    location = next(
        each for each in (COULOMB, PAYLOAD, GAIN, RIPPLE, LIMIT) if set(location_names(each)) == set(values)
    )
    return Fit((location.effect(values),), np.zeros(2), 0.0, NOTHING, covariance)


def location_names(location: Location) -> tuple[str, ...]:
    from via_sim.catalogue import EFFECTS

    return tuple(p.name for p in EFFECTS[location.name].parameters)
