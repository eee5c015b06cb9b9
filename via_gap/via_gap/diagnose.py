"""Logs and a nominal device in, a GapReport out: data check, localisation, candidates, evidence, verdict."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect

from via_gap.candidates.fit import Fit, converged, events, fit_base
from via_gap.candidates.localisation import SiteShare, localise
from via_gap.candidates.location import Location, locations, unjudged
from via_gap.candidates.scales import scales_of
from via_gap.logs.checks import check_log
from via_gap.logs.findings import Finding
from via_gap.logs.log import JointLog, believed
from via_gap.report.evidence_figures import evidence_figures, joint_sketch
from via_gap.report.figures import Figures
from via_gap.report.probability import shipped_numbers, with_probabilities
from via_gap.report.report import Cause, GapReport, NuisanceValue, Value, Where
from via_gap.report.report import Place as Named
from via_gap.report.sensor_causes import with_sensor_errors
from via_gap.report.withheld import runs_free, stretches
from via_gap.residual.equations import weak_residuals
from via_gap.residual.errors import Errors, equation_errors, free_errors, segment_errors
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.nuisance import BOUND
from via_gap.residual.repaired_device import repaired_device
from via_gap.residual.residual_model import ResidualModel, View
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Indices, Segments, cut_log, whole_log
from via_gap.selection.bound import flexible, lower
from via_gap.selection.calibration import calibration
from via_gap.selection.evidence import Evaluation, judge
from via_gap.selection.folds import STANDARD_ERRORS, Folds
from via_gap.selection.gap import Gap, SignalGap
from via_gap.selection.holdout import one_sided, split, split_finely
from via_gap.selection.search import Progress, Search
from via_gap.selection.verdict import Decision, Verdict, against_ceiling, decide
from via_gap.sensors.sensor_errors import sensor_errors
from via_gap.sensors.stamps import separate_delays


def diagnose(
    logs: Sequence[JointLog],
    device: Device,
    holdout: Sequence[JointLog] | None = None,
    progress: Progress | None = None,
    view: Callable[[Segments, Indices], View] = Rollout.of,
    groups: Mapping[str, Hashable] | None = None,
) -> GapReport:
    """Where the gap between `logs` and the nominal `device` lies, what causes it, and how far it shrinks.

    holdout   logs to judge on; without them blocks of `logs` are held out. Where motors follow their commands, so that
              a log is one free run, causes are chosen by `logs` alone, each judged by fits to others (see `Folds`)
    progress  is told what is being done and how much is done
    view      how segments are compared: Rollout.of simulates them, InverseDynamics.of balances their equation
    groups    of logs, by their names: those of one group never vouch for each other. Each its own without

    Raises SignalError where there is no log at all. A log that cannot be used is a finding in the report.
    """
    if not logs:
        raise SignalError("no log to diagnose")
    frozen = calibration(device.arrangement)
    every = believed([*logs, *(holdout or ())])
    logs, holdout = every[: len(logs)], every[len(logs) :] or None
    tell = progress or (lambda _what, _share: None)
    tell("looking at the data", 0.0)
    findings = [finding for log in (*logs, *(holdout or ())) for finding in check_log(log)]
    refused = {finding.log for finding in findings if finding.severity == "refuse"}
    cut = whole_log if holdout and runs_free(device) else cut_log
    usable, failures = _cut([log for log in logs if log.name not in refused], cut)
    judged_on, more = _cut([log for log in holdout or () if log.name not in refused], cut)
    findings += failures + more
    names = tuple(log.name for log in holdout) if holdout else ("blocks of the same logs",)
    short = GapReport(
        joint=device.name, level=logs[0].level, logs=tuple(log.name for log in logs), holdout=names,  # type: ignore[arg-type]
        verdict="cannot_tell", where=(), causes=(), equivalence_set=(), effects=(), gap=None, nuisance=(),
        data_check=tuple(findings), not_judged=_not_judged(logs[0]), figures=Figures(joint=joint_sketch(logs[0])),
    )  # fmt: skip
    if not usable or (holdout and not judged_on):
        return short
    train, held, everything = split(usable, judged_on)
    if cut is cut_log and (sum(map(len, train)) < 6 or sum(map(len, held)) < 3):
        few = Finding(
            log=logs[0].name, check="length", signal="time", severity="refuse", value=float(sum(map(len, train))),
            text="too few stretches of data to fit on some and judge on others",
        )  # fmt: skip
        return short.model_copy(update={"data_check": (*findings, few)})

    tell("fitting the device's own numbers", 0.05)
    fitted, judged, base, jacobian, before, tuned = _two_sides(everything, train, held, view)
    if not judged_on and one_sided(fitted.per_segment(base.residual), tuned.segments, frozen.no_gap):
        train, held = split_finely(everything)
        fitted, judged, base, jacobian, before, tuned = _two_sides(everything, train, held, view)
    folds = None
    if cut is whole_log:
        told = groups or {}
        folds = Folds.of(fitted, [told.get(s.log.name, i) for i, s in enumerate(usable) if len(train[i])])
    if folds is not None:
        frozen = frozen.model_copy(update={"significance": STANDARD_ERRORS})
        before, (tuned,) = folds.nominal(before.fit), folds.judge([base], None)
    if isinstance(judged.views[0], InverseDynamics):
        # What smoothing leaves of accelerations is in every segment, whatever the cause.
        frozen = frozen.model_copy(update={"typical": float("inf")})
    tell("localising", 0.15)
    numbers = repaired_device(device, fitted.nuisances, base.deviations)
    residuals = [weak_residuals(each, numbers) for each in everything]
    shares = localise(everything, residuals, numbers) if all(residuals) else ()
    causes: list[Evaluation] = []
    pairs: list[Evaluation] = []
    begins = [s.time[which] - s.log.measured.time[0] for s, which in zip(everything, train, strict=True)]
    seen = len(everything) if folds is None else len(usable)
    scales = scales_of(everything[:seen], residuals[:seen], np.concatenate(begins), fitted.per_segment(base.residual))
    candidates = locations(device, everything[0].log)
    if len(everything) > 1:  # what came and went at one time of one run is not the cause of the gap of several
        candidates = tuple(location for location in candidates if location.name != "external_torque")
    if tuned.mean_square > frozen.no_gap:
        tell("trying every effect at every place", 0.2)
        weigh = partial(judge, judged) if folds is None else partial(folds.judge, scales=scales)
        search = Search.of(fitted, weigh, base, jacobian, candidates, scales, folds is not None)
        causes = search.single(tell)
        leaders = causes[:1]
        if judged_on or not any(events(each.fit) for each in leaders):
            causes, pairs = search.more(causes, frozen, tell, at_events=not judged_on)
            leaders = sorted(pairs, key=lambda each: each.mean_square)[:1]
        if not judged_on and any(events(each.fit) for each in leaders):
            when = _events(search, leaders[0].fit, everything, view)
            train, held = split_finely(everything, when)
            fitted, judged, base, jacobian, before, tuned = _two_sides(everything, train, held, view)
            weigh = partial(judge, judged)
            if len(when) == 2:  # which the segments to fit alone might not lead to
                scales = replace(scales, busy=((when[0], when[1]), *scales.busy))
            search = Search.of(fitted, weigh, base, jacobian, candidates, scales)
            causes, pairs = search.more(search.single(tell), frozen, tell)
    tell("weighing the evidence", 0.9)
    (causes, pairs), answers = separate_delays([each.log for each in usable], causes, pairs)
    decision = decide(tuned, causes, pairs, frozen)
    if decision.locations:
        (chosen,) = weigh([converged(fitted, decision.chosen.fit, scales)])
        decision = decision.with_chosen(chosen)
    tell("measuring the gap", 0.95)
    gap = _gap(device, fitted, judged, everything, held, before, tuned, decision)
    if gap.by == "shots":  # equations have no flexible model beside them, and free runs pile up a hair's difference
        decision = against_ceiling(decision, gap, frozen)
    figures = evidence_figures(
        device, everything, held, residuals, numbers, judged, before, tuned, decision.chosen, [*causes, *pairs],
        candidates, gap.by,
    )  # fmt: skip
    report = short.model_copy(
        update={
            "verdict": _honest(decision.verdict, usable[0].log),
            "where": _where(device, shares, decision, tuned),
            "causes": tuple(_cause(device, each, probability, tuned) for each, probability in decision.ranked),
            "equivalence_set": tuple(_named(device, location) for location in decision.equivalent),
            "effects": tuple(_named(device, location) for location in decision.locations),
            "gap": gap,
            "nuisance": _nuisance(fitted, decision.chosen.fit.deviations),
            "data_check": (*findings, *answers),
            "figures": figures,
            "held_out": stretches(everything, held),
        }
    )
    report = with_probabilities(report, shipped_numbers())
    report = with_sensor_errors(report, sensor_errors([each.log for each in usable]))
    tell("done", 1.0)
    return GapReport.model_validate(report.model_dump())


def _two_sides(
    everything: Sequence[Segments],
    train: Sequence[Indices],
    held: Sequence[Indices],
    view: Callable[[Segments, Indices], View],
) -> tuple[ResidualModel, ResidualModel, Fit, Array, Evaluation, Evaluation]:
    """The segments to fit and to judge, the device's own numbers fitted, and what is wrong before and after that."""
    fitted, judged = ResidualModel.of(everything, train, view), ResidualModel.of(everything, held, view)
    base, jacobian = fit_base(fitted)
    nominal = Fit((), np.zeros_like(base.deviations), 0.0, np.empty(0), np.empty(0))
    before, tuned = judge(judged, [nominal, base])
    return fitted, judged, base, jacobian, before, tuned


def _events(
    search: Search, fit: Fit, everything: Sequence[Segments], view: Callable[[Segments, Indices], View]
) -> tuple[float, ...]:
    """When the effects of a fit to some segments begin and end, sought in all segments."""
    return search.events(fit, ResidualModel.of(everything, [np.flatnonzero(each.valid) for each in everything], view))


def _honest(verdict: Verdict, log: JointLog) -> Verdict:
    """'None of these' only where it can be known: unmeasured motors drift between segments, whatever the cause."""
    drifts = log.device.drive == "torque" and not all(log.motors_seen)
    return "cannot_tell" if verdict == "unknown" and drifts else verdict


def _cut(logs: Sequence[JointLog], cut: Callable[[JointLog], Segments]) -> tuple[list[Segments], list[Finding]]:
    segments, findings = [], []
    for log in logs:
        try:
            segments.append(cut(log))
        except SignalError as error:
            findings.append(
                Finding(log=log.name, check="usable", signal="all", severity="refuse", value=0.0, text=str(error))
            )
    return segments, findings


def _gap(
    device: Device, fitted: ResidualModel, judged: ResidualModel, segments: Sequence[Segments], held: Sequence[Indices],
    before: Evaluation, tuned: Evaluation, decision: Decision,
) -> Gap:  # fmt: skip
    chosen = decision.chosen.fit
    if isinstance(judged.views[0], InverseDynamics):
        errors = (equation_errors(judged, each.residual) for each in (before, tuned, decision.chosen))
        return _told("equations", *errors)
    model = flexible(fitted, chosen)
    if not runs_free(device):
        by: Literal["shots", "free run"] = "shots"
        three = [segment_errors(judged, each.residual) for each in (before, tuned, decision.chosen)]
        reached = segment_errors(judged, model.residual(judged, model.functions(judged)))
    else:
        by = "free run"

        def free(deviations: Array, effects: Sequence[Effect]) -> Errors:
            return free_errors(repaired_device(device, judged.nuisances, deviations), effects, segments, held)

        three = [free(each.fit.deviations, each.fit.effects) for each in (before, tuned, decision.chosen)]
        repaired = repaired_device(device, judged.nuisances, chosen.deviations)
        reached = free_errors(repaired, chosen.effects, [model.driven(each) for each in segments], held)
    first, second, third = three
    return _told(by, first, second, third, reached)


def _told(
    by: Literal["shots", "free run", "equations"], first: Errors, second: Errors, third: Errors,
    reached: Errors | None = None,
) -> Gap:  # fmt: skip
    """The gap of errors before, tuned and after; without a flexible model the sensors' floor is the ceiling."""
    low, high = np.quantile(third.resampled(), [0.025, 0.975])
    ceilings = first.floors if reached is None else lower(third, reached)
    signals = {
        name: SignalGap(
            before=float(a),
            after=float(b),
            floor=float(f),
            ceiling=float(c),
            closes=_closes(float(a), float(b), float(c)),
        )
        for name, a, b, f, c in zip(first.names, first.signals, third.signals, first.floors, ceilings, strict=True)
    }
    floor = float(np.sqrt(np.mean(first.floors**2)))
    ends = (first.overall, third.overall, float(np.sqrt(np.mean(ceilings**2))))
    return Gap(
        by=by, before=ends[0], tuned=second.overall, after=ends[1], interval=(float(low), float(high)),
        floor=floor, ceiling=ends[2], closes=_closes(*ends), signals=signals,
    )  # fmt: skip


def _closes(before: float, after: float, ceiling: float) -> float:
    """(before - after) / (before - ceiling); 1 where there was nothing to close."""
    possible = before - ceiling
    return 1.0 if possible <= 1e-12 else (before - after) / possible


def _where(device: Device, shares: tuple[SiteShare, ...], decision: Decision, tuned: Evaluation) -> tuple[Where, ...]:
    """The sites of the causes found, then what the equations alone say."""
    if decision.verdict == "no_gap":
        return ()
    from_equations = [
        Where(joint=device.name, site=s.site, motor=s.motor, equation=s.equation, share=s.share, regions=s.regions)  # type: ignore[arg-type]
        for s in shares
    ]
    weights: dict[tuple[str, int], float] = {}
    if decision.verdict in ("effect", "two_effects"):
        for location, weight in decision.site_weights:
            key = (location.site, location.motor)
            weights[key] = weights.get(key, 0.0) + weight
    named = []
    for (site, motor), weight in sorted(weights.items(), key=lambda each: -each[1]):
        same = [w for w in from_equations if (w.site, w.motor) == (site, motor)]
        equation = same[0].equation if same else "simulation"
        regions = same[0].regions if same else (from_equations[0].regions if from_equations else ())
        named.append(
            Where(joint=device.name, site=site, motor=motor, equation=equation, share=min(weight, 1.0), regions=regions)  # type: ignore[arg-type]
        )
    left = [w for w in from_equations if (w.site, w.motor) not in weights]
    rest = max(0.0, 1.0 - sum(w.share for w in named))
    scaled = [w.model_copy(update={"share": w.share * rest}) for w in left] if named else left
    return (*named, *(w for w in scaled if w.share >= 0.02))


def _cause(device: Device, each: Evaluation, probability: float, tuned: Evaluation) -> Cause:
    effect = each.fit.effects[-1]
    kind = EFFECTS[effect.name]
    sd = each.fit.sd[-len(kind.parameters) :]
    values = {
        p.name: Value(value=effect.parameters[p.name], sd=float(min(max(s, 0.0), 1e12)), unit=p.unit_on(device.drive))
        for p, s in zip(kind.parameters, sd, strict=True)
    }
    left = each.mean_square / max(tuned.mean_square, 1e-12)
    return Cause(
        effect=effect.name, site=effect.site, joint=device.name, motor=effect.motor,  # type: ignore[arg-type]
        probability=float(np.clip(probability, 0.0, 1.0)), parameters=values, left=left, score=each.score,
    )  # fmt: skip


def _named(device: Device, location: Location) -> Named:
    return Named(effect=location.name, site=location.site, joint=device.name, motor=location.motor)  # type: ignore[arg-type]


def _nuisance(problem: ResidualModel, deviations: Array) -> tuple[NuisanceValue, ...]:
    return tuple(
        NuisanceValue(
            name=n.name,
            unit=n.unit,
            filed=n.value,
            fitted=n.value * (1.0 + n.tolerance * float(d)),
            deviations=float(d),
            at_bound=bool(abs(d) > BOUND - 1e-6),
        )
        for n, d in zip(problem.nuisances, deviations, strict=True)
    )


def _not_judged(log: JointLog) -> tuple[str, ...]:
    said = []
    unseen = [i + 1 for i, seen in enumerate(log.motors_seen) if not seen]
    if unseen:
        which = " and ".join(f"motor {i}" for i in unseen)
        said.append(f"the angle of {which} was not measured: only the simulated link angle can be compared")
    if log.device.drive == "torque" and not log.torque_seen and log.device.n_motors:
        said.append("no motor torque was measured: commands stand for it, a torque sensor cannot be judged")
    if log.device.drive == "servo":
        said.append("motors are position servos: their torques and their friction are not in the model")
    return (*said, *unjudged(log.device, log))
