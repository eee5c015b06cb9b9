"""Fits with a periodic effect of one order, repeated with all orders that the residual shows.

An encoder error has whole periods per turn. So has a torque ripple, unless a gear is between the rotor and the angle
that is measured; it is fitted with whole orders, which stay, and with free ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.drive.torque_ripple import RIPPLE_HARMONICS
from via_sim.catalogue.sensor.encoder_eccentricity import ENCODER_HARMONICS

from via_gap.candidates.fit import FINISHING, Fit, members_of, refine
from via_gap.candidates.orders import Wave, encoder_waves, torque_waves
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
        periodic = [each for each in fits if any(place.name == name for place in each.locations)]
        for fit in sorted(periodic, key=lambda each: each.loss)[:REPEATED]:
            for number, place in enumerate(fit.locations):
                if place.name == name:
                    waves = _waves(whole, equations, fit, number)
                    if len(waves) > 1:
                        found.append(_richer(whole, fit, number, waves, scales))
                    if name == RIPPLE:
                        found.append(_richer(whole, fit, number, _with_whole_orders(waves), scales))
    return [each for each in found if each is not None]


def _waves(whole: ResidualModel, equations: ResidualModel | None, fit: Fit, number: int) -> list[Wave]:
    """All orders of a periodic effect of `fit`."""
    place = fit.locations[number]
    if place.name == ENCODER:
        return encoder_waves(whole, fit, number, ENCODER_HARMONICS)
    if equations is None:
        return []
    others = [effect for i, effect in enumerate(fit.effects) if i != number]
    axis = place.axis if equations.device.n_motors else 0
    return torque_waves(equations, equations.row(others, fit.offsets), axis, RIPPLE_HARMONICS)


def _with_whole_orders(waves: Sequence[Wave]) -> list[Wave]:
    """The waves with the nearest whole orders; of two with the same one, the larger."""
    nearest: dict[float, Wave] = {}
    for amplitude, order, phase in waves:
        whole = max(float(round(order)), 1.0)
        nearest.setdefault(whole, (amplitude, whole, phase))
    return list(nearest.values())


def _richer(whole: ResidualModel, fit: Fit, number: int, waves: Sequence[Wave], scales: Scales) -> Fit | None:
    """The fit with an effect of these orders; None if there is none, or if they contradict one another."""
    if not waves:
        return None
    given = {
        f"{name}{'' if k == 0 else f'_{k + 1}'}": value
        for k, wave in enumerate(waves)
        for name, value in zip(("amplitude", "order", "phase"), wave, strict=True)
    }
    members = members_of(fit)
    place = members[number][0]
    place = replace(place, optional=tuple(p.name for p in EFFECTS[place.name].optional if p.name in given))
    members[number] = (place, [given[p.name] for p in place.parameters])
    return refine(whole, fit, members, scales, FINISHING)
