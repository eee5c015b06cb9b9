"""Fits with a periodic effect of one order, repeated with all orders that the residual shows.

The number of periods per turn (the order) of an encoder error is whole. That of a torque ripple is whole too, unless a
gear is between the rotor and the measured angle. A ripple is therefore fitted twice: with whole orders, which are not
changed by the fit, and with free ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.drive.torque_ripple import RIPPLE_HARMONICS
from via_sim.catalogue.sensor.encoder_eccentricity import ENCODER_HARMONICS

from via_gap.candidates.fit import Fit
from via_gap.candidates.orders import Wave, encoder_waves, torque_waves
from via_gap.candidates.refinement import FINISHING, refine
from via_gap.candidates.scales import Scales
from via_gap.residual.residual_model import ResidualModel

RIPPLE, ENCODER = "torque_ripple", "encoder_eccentricity"
REPEATED = 2  # best fits of each periodic effect that are repeated, as two encoders may show nearly the same error


def with_harmonics(
    whole: ResidualModel, fits: Sequence[Fit], equations: ResidualModel | None, scales: Scales
) -> list[Fit]:
    """The best of `fits` with a periodic effect, with all its orders fitted together."""
    found: list[Fit | None] = []
    for name in (RIPPLE, ENCODER):
        periodic = [each for each in fits if any(location.name == name for location in each.locations)]
        for fit in sorted(periodic, key=lambda each: each.loss)[:REPEATED]:
            for number, location in enumerate(fit.locations):
                if location.name == name:
                    found += [
                        _richer(whole, fit, number, waves, scales) for waves in _waves(whole, equations, fit, number)
                    ]
    return [each for each in found if each is not None]


def _waves(whole: ResidualModel, equations: ResidualModel | None, fit: Fit, number: int) -> list[list[Wave]]:
    """All orders of a periodic effect of `fit`, as far as its one order is not all of it; several choices."""
    location = fit.locations[number]
    if location.name == ENCODER:
        waves = encoder_waves(whole, fit, number, ENCODER_HARMONICS)
        return [waves] if len(waves) > 1 else []
    if equations is None:
        return []
    others = [effect for i, effect in enumerate(fit.effects) if i != number]
    axis = location.axis if equations.device.n_motors else 0
    chosen = torque_waves(equations, equations.row(others, fit.offsets), axis, RIPPLE_HARMONICS)
    return [waves for waves in chosen if len(waves) > 1 or waves[0][1].is_integer()]


def _richer(whole: ResidualModel, fit: Fit, number: int, waves: Sequence[Wave], scales: Scales) -> Fit | None:
    """The fit with an effect of these orders; None if they contradict one another."""
    given = {
        f"{name}{'' if k == 0 else f'_{k + 1}'}": value
        for k, wave in enumerate(waves)
        for name, value in zip(("amplitude", "order", "phase"), wave, strict=True)
    }
    members = fit.members
    location = members[number][0]
    location = replace(location, optional=tuple(p.name for p in EFFECTS[location.name].optional if p.name in given))
    members[number] = (location, [given[p.name] for p in location.parameters])
    return refine(whole, fit, members, scales, FINISHING)
