"""Causes that were fitted, dropped after a first fit, or never tried, as the report lists them."""

from __future__ import annotations

from collections.abc import Sequence

from via_sim.catalogue import EFFECTS

from via_gap.candidates.location import MEASUREMENT_ONLY, Location
from via_gap.report.binning import six
from via_gap.report.figures import Member, Trial
from via_gap.selection.evidence import Evaluation, difference

TRIALS = 16  # that are listed


def trial_figures(models: Sequence[Evaluation], tuned: Evaluation) -> tuple[Trial, ...]:
    """Causes and sets of causes with their held-out evidence, best score first, each set of locations once."""
    best: dict[frozenset[Location], Evaluation] = {}
    for each in sorted(models, key=lambda each: each.score):
        best.setdefault(frozenset(each.fit.locations), each)
    ranked = list(best.values())[:TRIALS]
    found = []
    for each in ranked:
        behind, sd = difference(each, ranked[0])
        left = each.mean_square / max(tuned.mean_square, 1e-12)
        members = tuple(map(_member, each.fit.locations))
        found.append(Trial(effects=members, left=six(left), behind=six(behind), behind_sd=six(sd)))
    return tuple(found)


def screened_members(candidates: Sequence[Location], models: Sequence[Evaluation]) -> tuple[Member, ...]:
    """Candidates that are in no trial."""
    fitted = {location for each in models for location in each.fit.locations}
    return tuple(_member(location) for location in candidates if location not in fitted)


def untried_effects(candidates: Sequence[Location]) -> tuple[str, ...]:
    """Effects of the catalogue that are neither candidates nor found in the measurements themselves."""
    tried = {*MEASUREMENT_ONLY, *(location.name for location in candidates)}
    return tuple(name for name in EFFECTS if name not in tried)


def _member(location: Location) -> Member:
    return Member(effect=location.name, site=location.site, motor=location.motor)
