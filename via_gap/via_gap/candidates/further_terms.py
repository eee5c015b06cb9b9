"""The best fits, repeated with more terms of their effects.

A periodic effect has several orders (periodic.py), others have further terms (`EffectKind.further`). Example: friction
of a gear also depends on the torque from its other side, and is larger near standstill. Without these terms, a
simulated joint creeps where the real one rests under a load. Terms are tried in every fit that may be the answer.
Otherwise one of two rivals would win only because it has more terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_gap.candidates.fit import Fit, Members
from via_gap.candidates.periodic import with_harmonics
from via_gap.candidates.refinement import FINISHING, refine_all
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel

MOST = 4  # fits
CLOSE = 2.0  # times the best loss: fits beyond it rarely become the best by these terms


def richer(whole: ResidualModel, fits: Sequence[Fit], equations: ResidualModel | None, scales: Scales) -> list[Fit]:
    """The best of `fits` with several orders of a periodic effect, or with further terms of an effect."""
    return with_harmonics(whole, fits, equations, scales) + with_further_terms(whole, fits, scales)


def with_further_terms(whole: ResidualModel, fits: Sequence[Fit], scales: Scales) -> list[Fit]:
    """The best of `fits`, each with every set of further terms of one of its effects."""
    order = sorted(fits, key=lambda each: each.loss)
    near = [each for each in order[:MOST] if each.loss < CLOSE * order[0].loss]
    places = [(fit, number) for fit in near for number in range(len(fit.effects))]
    begun = [(fit, each) for fit, number in places for each in _with_terms(fit, number, scales)]
    return [fit for fit in refine_all(whole, begun, scales, FINISHING) if fit is not None]


def _with_terms(fit: Fit, number: int, scales: Scales) -> list[Members]:
    """The effects of a fit with each set of further terms of one of them."""
    location, effect = fit.locations[number], fit.effects[number]
    if location.kind.further is None:
        return []
    speed, torque = float(scales.speed[location.axis]), float(scales.torque[location.axis])
    found = []
    for further in location.kind.further(effect.parameters, speed, torque):
        members, more = fit.members, replace(location, optional=tuple(further))
        values = {**effect.parameters, **further}
        members[number] = (more, [values[p.name] for p in more.parameters])
        found.append(members)
    return found
