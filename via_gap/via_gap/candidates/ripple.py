"""Fits with a torque ripple of one order, repeated with all orders that the equations show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_sim.catalogue import EFFECTS
from via_sim.parameters import RIPPLE_HARMONICS

from via_gap.candidates.fit import FINISHING, Fit, members_of, refine
from via_gap.candidates.orders import harmonics
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel

RIPPLE = "torque_ripple"


def with_harmonics(
    whole: ResidualModel, fits: Sequence[Fit], equations: ResidualModel | None, scales: Scales
) -> list[Fit]:
    """The first of `fits` with a ripple, with all its orders fitted together; empty if there is only one order."""
    fit = next((each for each in fits if any(place.name == RIPPLE for place in each.locations)), None)
    if fit is None or equations is None:
        return []
    found = []
    for number, (place, _) in enumerate(members_of(fit)):
        if place.name != RIPPLE:
            continue
        others = [effect for i, effect in enumerate(fit.effects) if i != number]
        axis = place.axis if equations.device.n_motors else 0
        waves = harmonics(equations, equations.row(others, fit.offsets), axis, RIPPLE_HARMONICS)
        if len(waves) > 1:
            optional = tuple(p.name for p in EFFECTS[RIPPLE].optional[: 3 * (len(waves) - 1)])
            members = members_of(fit)
            members[number] = (replace(place, optional=optional), [value for wave in waves for value in wave])
            richer = refine(whole, fit, members, scales, FINISHING)
            found += [richer] if richer is not None else []
    return found
