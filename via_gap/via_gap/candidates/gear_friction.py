"""The best fit with friction proportional to the load, repeated with the further terms that gears show.

Friction of a gear also depends on the torque from its other side, and is larger near standstill. A joint that rests
under a load shows these terms; without them the simulated joint creeps. The terms are those of the models M5 and M6 in
via_sim/joint/friction.py. Both are tried, because a short log rarely determines all terms together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_gap.candidates.fit import FINISHING, Fit, members_of, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel

NAME = "load_dependent_friction"
SHARE = 0.3  # initial value of each further term over the coefficient of the load, and of its velocity over the speed


def with_gear_terms(whole: ResidualModel, fits: Sequence[Fit], scales: Scales) -> list[Fit]:
    """The best of `fits` with the further terms of its load-dependent friction; none if it has no such friction."""
    best = min(fits, key=lambda each: each.loss, default=None)
    numbers = [] if best is None else [i for i, location in enumerate(best.locations) if location.name == NAME]
    if best is None or not numbers:
        return []
    location, (coefficient, *_) = members_of(best)[numbers[0]]
    share, velocity = SHARE * coefficient, SHARE * float(scales.speed[location.axis])
    found = []
    for further in (
        {"velocity": velocity, "quadratic": share / float(scales.torque[location.axis])},
        {"counter_coefficient": share, "stribeck": share, "counter_stribeck": share, "velocity": velocity},
    ):
        members = members_of(best)
        members[numbers[0]] = (replace(location, optional=tuple(further)), [coefficient, *further.values()])
        fit = refine(whole, best, members, scales, FINISHING)
        found += [fit] if fit is not None else []
    return found
