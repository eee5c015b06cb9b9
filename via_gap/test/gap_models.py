"""Evaluated models that no log stands behind: effects with given losses of held-out segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from gap_logs import flexible, log_of
from via_core.signals import Array
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales, scales_of
from via_gap.residual.inverse_dynamics import missing_torque
from via_gap.residual.segments import cut_log
from via_gap.selection.evidence import Evaluation
from via_sim.catalogue import EFFECTS

NOTHING = np.empty(0)
COULOMB = Location("coulomb_friction", "motor", 1)
STRIBECK = Location("stribeck_friction", "motor", 1)
VISCOUS = Location("viscous_friction", "motor", 1)
BACKLASH = Location("backlash", "transmission", 1)
DAMPING = Location("spring_damping", "transmission", 1)
PAYLOAD = Location("payload", "link", 0)
INERTIA = Location("link_inertia", "link", 0)
DRAG = Location("quadratic_drag", "link", 0)
PLACES = (COULOMB, STRIBECK, VISCOUS, BACKLASH, DAMPING, PAYLOAD, INERTIA, DRAG)


def fit_of(locations: Sequence[Location], sd: float = 0.1) -> Fit:
    """Effects at these locations, halfway from absent to twice a unit, each parameter known to `sd`."""
    effects, count = [], 0
    for location in locations:
        parameters = EFFECTS[location.name].parameters
        values = {p.name: float(np.clip(p.neutral + 1.0, p.low, p.high)) for p in parameters}
        effects.append(location.effect(values))
        count += len(parameters)
    return Fit(tuple(effects), np.zeros(2), 0.0, NOTHING, sd**2 * np.eye(count))


def evaluated(
    segments: Sequence[float] | Array, *locations: Location, block: int = 4, whole: bool = False,
    other_view: Sequence[float] | Array = NOTHING,
) -> Evaluation:  # fmt: skip
    """A model and the mean squared whitened error that it leaves of each held-out segment."""
    return Evaluation(
        fit_of(locations), NOTHING, np.asarray(segments, dtype=np.float64), block, whole, np.asarray(other_view)
    )


@cache
def scales() -> Scales:
    """Typical sizes in a log of a flexible joint."""
    log = log_of(flexible(), (), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    found = scales_of([segments], [missing_torque(segments, log.device)])
    return replace(found, missing=np.full(3, np.inf))  # the log has no effect, the fits that are tested have
