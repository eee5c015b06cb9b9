"""The best fits with friction proportional to the load, repeated with the further terms that gears show.

Friction of a gear also depends on the torque from its other side, and is larger near standstill. A joint that rests
under a load shows these terms; without them the simulated joint creeps. The terms are those of the models M3, M5 and
M6 in via_sim/joint/friction.py. Several sets are tried, because a short log rarely determines all terms together. They
are tried in every fit that may be the answer: with more terms in one of two rivals, it would win by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_gap.candidates.fit import Fit, members_of
from via_gap.candidates.refinement import FINISHING, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel

NAME = "load_dependent_friction"
MOST = 4  # fits
CLOSE = 2.0  # times the best loss: fits beyond it rarely become the best by these terms
SHARE = 0.3  # initial value of each further term over the coefficient of the load, and of its velocity over the speed


def with_gear_terms(whole: ResidualModel, fits: Sequence[Fit], scales: Scales) -> list[Fit]:
    """The best of `fits`, each with the further terms of its load-dependent friction; none if they have none."""
    order = sorted(fits, key=lambda each: each.loss)
    near = [each for each in order[:MOST] if each.loss < CLOSE * order[0].loss]
    return [found for each in near for found in _repeated(whole, each, scales)]


def _repeated(whole: ResidualModel, fit: Fit, scales: Scales) -> list[Fit]:
    """The fit with each set of further terms; none if it has no load-dependent friction."""
    numbers = [i for i, location in enumerate(fit.locations) if location.name == NAME]
    if not numbers:
        return []
    location, (coefficient, *_) = members_of(fit)[numbers[0]]
    share, velocity = SHARE * coefficient, SHARE * float(scales.speed[location.axis])
    found = []
    for further in (
        {"counter_coefficient": share},
        {"velocity": velocity, "quadratic": share / float(scales.torque[location.axis])},
        {"counter_coefficient": share, "stribeck": share, "counter_stribeck": share, "velocity": velocity},
    ):
        members = members_of(fit)
        members[numbers[0]] = (replace(location, optional=tuple(further)), [coefficient, *further.values()])
        again = refine(whole, fit, members, scales, FINISHING)
        found += [again] if again is not None else []
    return found
