"""The result of an experiment: the decision, and the gap before a repair, after it, and at the achievable bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from via_core.signals import Array

from via_gap.logs.findings import Finding, Number, Record
from via_gap.residual.errors import Errors, free_errors, segment_errors, torque_errors
from via_gap.residual.recordings import follows
from via_gap.selection.achievable import Achievable
from via_gap.selection.comparison import ModelComparison
from via_gap.selection.contribution import by_contribution, confirmed, reduced
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.rivals import rivals
from via_gap.selection.transfer import transferred
from via_gap.selection.verdict import Decision, decide

By = Literal["segments", "free run", "inverse dynamics"]


class SignalGap(Record):
    """Error of one signal over the standard deviation of the measured one, on held-out data."""

    before: Number
    after: Number
    floor: Number
    bound: Number
    explained: Number


class Gap(Record):
    """The gap over all signals: root mean square of those of each.

    before     of the device file as filed
    tuned      of its parameters fitted inside their tolerances, without effects
    after      of fitted parameters and named effects
    interval   95 % interval of `after`, from resampled blocks
    floor      of sensor noise alone
    bound      achievable error: of the repair or, if lower, of a flexible torque model beside it
    explained  (before - after) / (before - bound)
    by         'segments': short runs from measured states; 'free run': one run over the whole log;
               'inverse dynamics': missing torque of the equations, relative to the torque of the drive
    """

    by: By
    before: Number
    tuned: Number
    after: Number
    interval: tuple[Number, Number]
    floor: Number
    bound: Number
    explained: Number
    signals: dict[str, SignalGap]


@dataclass(frozen=True, eq=False)
class Result:
    """Models compared, the decision about them, and the gap.

    findings  of the comparison, beside those of the recordings
    part      name of the log, begin and end [s] of what all of it is about; None: the whole recordings
    """

    comparison: ModelComparison
    decision: Decision
    gap: Gap
    findings: tuple[Finding, ...] = ()
    part: tuple[str, float, float] | None = None


def decide_and_measure(comparison: ModelComparison, findings: Sequence[Finding] = ()) -> Result:
    """The decision, with the chosen model fitted to convergence, and its gap.

    A model that its final fit does not confirm is withdrawn, and the others decide. Nothing is named if the repair of
    one half of the motion does not hold in the other, or its held-out gap is not below that of the fitted device
    parameters alone.
    """
    experiment = comparison.experiment
    achievable = Achievable(experiment)
    scales = comparison.candidates.scales
    models = list(comparison.models)
    while True:
        rivals_of = rivals(experiment.fitted, models, scales, comparison.evaluated)
        decision = decide(experiment.tuned, models, achievable.beside, rivals_of).converged(experiment, scales)
        fewer = reduced(decision, comparison)
        others = [each for each in models if set(each.fit.locations) != set(decision.named)]
        if confirmed(decision, fewer, experiment.tuned) or len(others) == len(models):
            break
        models = others
    decision = by_contribution(decision, fewer)
    if decision.verdict == "main_effect":
        elsewhere = transferred(decision.chosen, experiment, scales)
        if by := elsewhere.refuted_by:
            why = f"what explains one half of the motion, divided by {by}, does not explain the other"
            decision = decision.refuted(experiment.tuned, why)
        if decision.named:
            decision = replace(decision, transfer=elsewhere.shares, halves=elsewhere.worst)
    gap = measured_gap(experiment, decision.chosen, achievable)
    if decision.named and gap.after >= gap.tuned:
        why = "the effects that explain the fitted recordings do not reduce the error of the held-out ones"
        decision = decision.refuted(experiment.tuned, why)
        gap = measured_gap(experiment, experiment.tuned, achievable)
    compared = replace(comparison, models=[*comparison.models, *decision.rivals])
    return Result(compared, decision, gap, tuple(findings))


def measured_gap(experiment: Experiment, chosen: Evaluation, achievable: Achievable) -> Gap:
    """The gap of an experiment with the effects of `chosen`."""
    fits = [each.fit for each in (experiment.nominal, experiment.tuned, chosen)]
    data, by_equations = experiment.evaluated, experiment.by_equations
    if by_equations or not follows(data.device):
        errors_of = torque_errors if by_equations else segment_errors
        errors = [errors_of(data, data.residual([data.row(fit.effects, fit.offsets)])[0]) for fit in fits]
        if by_equations:
            share = achievable.beside(chosen).rms / max(chosen.rms, 1e-12)
            return _gap("inverse dynamics", errors, errors[2].signals * min(share, 1.0))
        model = achievable.model(chosen.fit)
        reached = segment_errors(data, model.residual(data, model.functions(data)))
        return _gap("segments", errors, reached.signals)
    devices = [data.repaired(fit.offsets) for fit in fits]
    errors = [
        free_errors(device, fit.effects, experiment.segments, experiment.held)
        for device, fit in zip(devices, fits, strict=True)
    ]
    driven = [achievable.model(chosen.fit).driven(each) for each in experiment.segments]
    reached = free_errors(devices[2], chosen.fit.effects, driven, experiment.held)
    return _gap("free run", errors, reached.signals)


def _gap(by: By, errors: Sequence[Errors], reached: Array) -> Gap:
    """The gap from errors before, tuned and after, and the errors `reached` (n,) by a flexible model."""
    first, second, third = errors
    low, high = np.quantile(third.resampled(), [0.025, 0.975])
    bounds = np.maximum(np.minimum(third.signals, reached), first.floors)
    columns = zip(first.names, first.signals, third.signals, first.floors, bounds, strict=True)
    signals = {
        name: SignalGap(before=float(a), after=float(b), floor=float(f), bound=float(c), explained=_explained(a, b, c))
        for name, a, b, f, c in columns
    }
    ends = (first.overall, third.overall, float(np.sqrt(np.mean(bounds**2))))
    return Gap(
        by=by, before=ends[0], tuned=second.overall, after=ends[1], interval=(float(low), float(high)),
        floor=float(np.sqrt(np.mean(first.floors**2))), bound=ends[2], explained=_explained(*ends), signals=signals,
    )  # fmt: skip


def _explained(before: float, after: float, bound: float) -> float:
    """(before - after) / (before - bound); 1 if nothing can be explained."""
    possible = before - bound
    return 1.0 if possible <= 1e-12 else float((before - after) / possible)
