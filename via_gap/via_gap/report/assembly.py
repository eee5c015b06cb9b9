"""A report from what the stages found: one decision, everything else follows from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.devices import Device
from via_core.signals import Array
from via_sim.effects import spots

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.candidates.fit import bounds_of
from via_gap.candidates.location import Location, unjudged
from via_gap.candidates.scales import Scales
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog
from via_gap.report.combinations import combinations
from via_gap.report.evidence_figures import evidence_figures, joint_sketch
from via_gap.report.figures import Figures
from via_gap.report.report import Cause, GapReport, Noise, NuisanceValue, Place, Value, Where
from via_gap.report.withheld import stretches
from via_gap.residual.nuisance import BOUND
from via_gap.residual.recordings import Recordings
from via_gap.residual.residual_model import ResidualModel
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import Gap
from via_gap.selection.reliability import in_conformal_set, reliability, shipped
from via_gap.selection.verdict import Decision
from via_gap.sensors.sensor_errors import SensorError

SHOWN = 0.02  # share of a site from which it is listed
SENSOR = 0.98  # probability that what a sensor's own measurements show is what it seems


def unanswered(recordings: Recordings) -> GapReport:
    """The report on recordings that cannot answer: what was noticed about them."""
    refusals = [each.text for each in recordings.findings if each.severity == "refuse"]
    return GapReport(
        joint=recordings.device.name, level=recordings.first.level, logs=recordings.names, holdout=_judges(recordings),
        verdict="cannot_tell", reason=recordings.unusable or next(iter(refusals), ""), where=(), causes=(),
        equivalence_set=(), effects=(), gap=None, nuisance=(), data_check=recordings.findings, noise=_noise(recordings),
        not_judged=_not_judged(recordings.first),
        figures=Figures(joint=joint_sketch(recordings.first)),
    )  # fmt: skip


def answered(
    recordings: Recordings, experiment: Experiment, candidates: CandidateSet, models: Sequence[Evaluation],
    decision: Decision, gap: Gap, sensors: Sequence[SensorError], findings: Sequence[Finding],
) -> GapReport:  # fmt: skip
    """The report on a decision, and on errors that the sensors' own measurements show."""
    device = recordings.device
    causes = _causes(device, decision, candidates.scales, experiment.tuned)
    wrong = tuple(_sensor_cause(device.name, each) for each in sensors)
    named = tuple(_place(device, location) for location in decision.named)
    verdict, effects, equivalent = decision.verdict, named, tuple(_place(device, e) for e in decision.equivalent)
    if wrong and verdict not in ("unknown", "cannot_tell"):
        also = tuple(Place(effect=c.effect, site=c.site, joint=c.joint, motor=c.motor) for c in wrong)
        effects, equivalent = (*named, *also), (*equivalent, *also)
        first = sorted((*causes[: len(named)], *wrong), key=lambda each: -each.probability)
        causes = (*first, *causes[len(named) :])
        if verdict != "main_effect":
            verdict = "effect" if len(effects) == 1 else "several_effects"
    report = GapReport(
        joint=device.name, level=recordings.first.level, logs=recordings.names, holdout=_judges(recordings),
        verdict=verdict, reason=decision.reason, explained=float(np.clip(decision.explained, 0.0, 1.0)),
        where=_where(device, candidates, decision, wrong if effects != named else ()), causes=causes,
        equivalence_set=equivalent, conformal_set=_conformal(recordings.first.level, causes), effects=effects, gap=gap,
        nuisance=_device_numbers(experiment.fitted, decision.chosen.fit.deviations),
        data_check=(*recordings.findings, *findings), noise=_noise(recordings),
        not_judged=_not_judged(recordings.first),
        figures=evidence_figures(experiment, candidates, decision, models, gap.by),
        held_out=stretches(experiment.segments, experiment.held),
    )  # fmt: skip
    return GapReport.model_validate(report.model_dump())


def _judges(recordings: Recordings) -> tuple[str, ...]:
    return recordings.holdout or ("blocks of the same logs",)


def _causes(device: Device, decision: Decision, scales: Scales, tuned: Evaluation) -> tuple[Cause, ...]:
    """Every cause compared, those named first, then by probability."""
    trust = reliability(decision.verdict)
    found: list[tuple[bool, float, Cause]] = []
    for (location, share), model in zip(decision.shares, decision.models, strict=True):
        found.append((location in decision.named, share, _cause(device, location, model, share, scales, tuned)))
    found.sort(key=lambda each: (-each[0], -each[1]))
    return tuple(cause.model_copy(update={"probability": trust * cause.share}) for _, _, cause in found)


def _cause(
    device: Device, location: Location, model: Evaluation, share: float, scales: Scales, tuned: Evaluation
) -> Cause:
    number = model.fit.locations.index(location)
    effect = model.fit.effects[number]
    first = sum(len(each.parameters) for each in model.fit.effects[:number])
    parameters = model.fit.locations[number].parameters
    own = slice(first, first + len(parameters))
    sd = model.fit.sd[own]
    low, high = bounds_of(model.fit.locations[number], scales)
    values = {
        p.name: Value(
            value=effect.parameters[p.name], sd=float(np.clip(s, 0.0, 1e12)), unit=p.unit_on(device.drive),
            low=float(a), high=float(b), neutral=p.neutral,
        )
        for p, s, a, b in zip(parameters, sd, low, high, strict=True)
    }  # fmt: skip
    return Cause(
        effect=effect.name, site=effect.site, joint=device.name, motor=effect.motor,  # type: ignore[arg-type]
        probability=0.0, share=float(np.clip(share, 0.0, 1.0)), parameters=values,
        combinations=combinations(effect, model.fit.covariance[own, own]),
        left=model.mean_square / max(tuned.mean_square, 1e-12), score=model.score,
    )  # fmt: skip


def _sensor_cause(joint: str, found: SensorError) -> Cause:
    effect = found.effect
    unit = {"quantum": "rad", "gain": "-", "torque": "N m"}
    return Cause(
        effect=effect.name, site="sensor", joint=joint, motor=effect.motor, probability=SENSOR, share=1.0,
        parameters={n: Value(value=v, sd=found.sd[n], unit=unit[n]) for n, v in effect.parameters.items()},
        left=found.left, score=float(np.log1p(found.left)),
    )  # fmt: skip


def _conformal(level: str, causes: Sequence[Cause]) -> tuple[Place, ...]:
    inside = in_conformal_set([cause.share for cause in causes], level)
    kept = [cause for cause, within in zip(causes, inside, strict=True) if within]
    return tuple(Place(effect=c.effect, site=c.site, joint=c.joint, motor=c.motor) for c in kept)


def _place(device: Device, location: Location) -> Place:
    return Place(effect=location.name, site=location.site, joint=device.name, motor=location.motor)  # type: ignore[arg-type]


def _where(device: Device, candidates: CandidateSet, decision: Decision, sensors: Sequence[Cause]) -> tuple[Where, ...]:
    """Sites of the causes named, weighted by their shares, then what the equations alone show."""
    if decision.verdict == "no_gap":
        weights: dict[tuple[str, int], float] = {}
    else:
        weights = _weights(decision)
    for cause in sensors:
        weights[(cause.site, cause.motor)] = weights.get((cause.site, cause.motor), 0.0) + 1.0
    total = sum(weights.values())
    shares = {(s.site, s.motor): s for s in candidates.shares}
    seen = {(c.site, c.motor) for c in sensors}
    named = []
    for (site, motor), weight in sorted(weights.items(), key=lambda each: -each[1]):
        same = max((shares[each] for each in spots(site, motor) if each in shares), key=lambda s: s.share, default=None)
        equation = "measurements" if (site, motor) in seen else same.equation if same else "simulation"
        regions = same.regions if same else ()
        named.append(
            Where(joint=device.name, site=site, motor=motor, equation=equation, share=weight / total, regions=regions)  # type: ignore[arg-type]
        )
    if named or decision.verdict == "no_gap":
        return tuple(each for each in named if each.share >= SHOWN)
    return tuple(
        Where(joint=device.name, site=s.site, motor=s.motor, equation=s.equation, share=s.share, regions=s.regions)  # type: ignore[arg-type]
        for s in candidates.shares
        if s.share >= SHOWN
    )


def _weights(decision: Decision) -> dict[tuple[str, int], float]:
    """Share of each site among the causes compared, where causes are named; an effect counts as often as it is best."""
    weights: dict[tuple[str, int], float] = {}
    if not decision.named:
        return weights
    for location, share in decision.shares:
        key = (location.site, location.motor)
        weights[key] = weights.get(key, 0.0) + share
    return weights


def _device_numbers(problem: ResidualModel, deviations: Array) -> tuple[NuisanceValue, ...]:
    return tuple(
        NuisanceValue(
            name=n.name, unit=n.unit, filed=n.value, fitted=n.value * (1.0 + n.tolerance * float(d)),
            deviations=float(d), at_bound=bool(abs(d) > BOUND - 1e-6),
            low=n.value - BOUND * n.tolerance * abs(n.value), high=n.value + BOUND * n.tolerance * abs(n.value),
        )
        for n, d in zip(problem.nuisances, deviations, strict=True)
    )  # fmt: skip


def _noise(recordings: Recordings) -> tuple[Noise, ...]:
    """Declared and estimated noise of every channel of every log that was used."""
    return tuple(
        Noise(
            log=log, channel=name, unit="N m" if name.startswith("tau") else "rad", declared=noise.declared.get(name),
            estimated=each.sd, jitter=each.jitter,
        )
        for log, noise in recordings.noise.items()
        for name, each in noise.channels.items()
    )  # fmt: skip


def _not_judged(log: JointLog) -> tuple[str, ...]:
    said = []
    unseen = [i + 1 for i, seen in enumerate(log.motors_seen) if not seen]
    if unseen:
        which = " and ".join(f"motor {i}" for i in unseen)
        said.append(f"the angle of {which} was not measured: only the simulated link angle can be compared")
    if log.device.drive == "torque" and not log.torque_seen and log.device.n_motors:
        said.append("no motor torque was measured: commands are used instead, a torque sensor cannot be judged")
    if log.device.drive == "servo":
        said.append("motors are position servos: their torques and their friction are not in the model")
    if not shipped().cases:
        said.append("probabilities are not calibrated in this version: the ranking counts, not their size")
    return (*said, *unjudged(log.device, log))
