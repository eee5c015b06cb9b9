"""The answer of a report: the decision about the motion, and the errors that the sensors' own measurements show."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_sim.effects import spots

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.localisation import SiteShare
from via_gap.candidates.location import Location
from via_gap.logs.log import Level
from via_gap.report.causes import compared_causes, conformal_set, sensor_causes
from via_gap.report.report import Cause, EffectLocation, Where
from via_gap.selection.comparison import ModelComparison
from via_gap.selection.verdict import UNNAMED, Decision, Verdict
from via_gap.sensors.sensor_errors import SensorError

SHOWN = 0.02  # share of a site from which it is listed
Weights = dict[tuple[str, int], float]  # of sites (site, motor)


@dataclass(frozen=True)
class Answer:
    """The keys of a report that follow from decision and sensor errors; see `GapReport`."""

    verdict: Verdict
    where: tuple[Where, ...]
    causes: tuple[Cause, ...]
    equivalence_set: tuple[EffectLocation, ...]
    conformal_set: tuple[EffectLocation, ...] | None
    effects: tuple[EffectLocation, ...]


def answer(level: Level, comparison: ModelComparison, decision: Decision, sensors: Sequence[SensorError]) -> Answer:
    """The answer; sensor errors are added to the named effects.

    If nothing explains the motion, a sensor error is the main effect if it exceeds the torque that is missing there.
    """
    experiment, candidates = comparison.experiment, comparison.candidates
    device = experiment.evaluated.device
    causes = compared_causes(device, decision, candidates.scales, experiment.tuned)
    named = tuple(_place(device, each) for each in decision.named)
    equivalent = tuple(_place(device, each) for each in decision.equivalent)
    unnamed = decision.verdict in UNNAMED
    if not sensors or (unnamed and not any(_outweighs(each, candidates) for each in sensors)):
        where = _where(device, candidates, decision, ())
        known = conformal_set(decision.verdict, level, causes)
        return Answer(decision.verdict, where, causes, equivalent, known, named)
    wrong = sensor_causes(device.name, sensors)
    places = tuple(each.place for each in wrong)
    surer = [each for each in wrong if not named or each.probability > causes[0].probability]
    causes = (*surer, *causes[: len(named)], *(each for each in wrong if each not in surer), *causes[len(named) :])
    verdict = decision.verdict
    if unnamed:
        verdict = "main_effect"
    elif verdict != "main_effect":
        verdict = "effect" if len(named) + len(wrong) == 1 else "several_effects"
    where = _where(device, candidates, decision, wrong)
    effects, equivalent = (*named, *places), (*equivalent, *places)
    return Answer(verdict, where, causes, equivalent, conformal_set(verdict, level, causes), effects)


def _outweighs(error: SensorError, candidates: CandidateSet) -> bool:
    """Whether the error of a torque sensor exceeds the torque that is missing on its motor."""
    axis = error.effect.motor
    missing = [m.torque[:, m.axes.index(axis)] for m in candidates.missing if m is not None and axis in m.axes]
    if not missing or not error.size:
        return False
    return error.size > float(np.sqrt(np.mean(np.concatenate(missing) ** 2)))


def _place(device: Device, location: Location) -> EffectLocation:
    return EffectLocation(effect=location.name, site=location.site, joint=device.name, motor=location.motor)  # type: ignore[arg-type]


def _where(device: Device, candidates: CandidateSet, decision: Decision, sensors: Sequence[Cause]) -> tuple[Where, ...]:
    """Sites of the causes named, weighted by their shares; where none is named, what the equations alone show."""
    weights = _weights(decision, sensors)
    shares = {(s.site, s.motor): s for s in candidates.shares}
    if weights:
        measured = {(each.site, each.motor) for each in sensors}
        total = sum(weights.values())
        found = [
            _named_site(device, spot, weight / total, shares, spot in measured)
            for spot, weight in sorted(weights.items(), key=lambda each: -each[1])
        ]
    elif decision.verdict == "no_gap":
        found = []
    else:
        found = [Where(joint=device.name, **vars(each)) for each in candidates.shares]
    return tuple(each for each in found if each.share >= SHOWN)


def _weights(decision: Decision, sensors: Sequence[Cause]) -> Weights:
    """Weight of each site: how often its effects are in the best model, plus 1 for each sensor error there.

    If several effects are named, each counts by the part of the error that it explains; their mean part is 1.
    """
    weights: Weights = defaultdict(float)
    for location, share in decision.shares if decision.named else ():
        weights[location.site, location.motor] += share * decision.alone(location) * decision.part(location)
    for cause in sensors:
        weights[cause.site, cause.motor] += 1.0
    return weights


def _named_site(
    device: Device, spot: tuple[str, int], share: float, shares: Mapping[tuple[str, int], SiteShare], measured: bool
) -> Where:
    """A site with the equation and the regions in which the residual is largest there."""
    same = max((shares[each] for each in spots(*spot) if each in shares), key=lambda s: s.share, default=None)
    equation = "measurements" if measured else same.equation if same else "simulation"
    regions = same.regions if same else ()
    return Where(joint=device.name, site=spot[0], motor=spot[1], equation=equation, share=share, regions=regions)  # type: ignore[arg-type]
