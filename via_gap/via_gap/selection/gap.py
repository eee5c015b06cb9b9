"""The decision with the gap in numbers: before a repair, after it, and the least that can be reached."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.candidates.scales import Scales
from via_gap.logs.findings import Number, Record
from via_gap.residual.errors import Errors, free_errors, segment_errors, torque_errors
from via_gap.residual.recordings import follows
from via_gap.residual.repaired_device import repaired_device
from via_gap.selection.achievable import Achievable
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
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

    before     the device file as it stands
    tuned      its numbers moved inside their tolerance, no effect
    after      those numbers and the effects named
    interval   95 % of `after`, from resampled blocks
    floor      what the sensors alone leave
    bound      achievable error: the least that a flexible torque model beside the repair, or the repair itself, leaves
    explained  (before - after) / (before - bound)
    by         'segments': short runs from measured states; 'free run': one run over the whole log;
               'inverse dynamics': torque that the equations lack, against the drive's
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


def decided(experiment: Experiment, models: Sequence[Evaluation], scales: Scales) -> tuple[Decision, Gap]:
    """The decision about `models`, the chosen one fitted to the end, and its gap.

    Nothing is named where the repair leaves no less of the held-out gap than the device's own numbers alone.
    """
    achievable = Achievable(experiment)
    decision = decide(experiment.tuned, models, achievable.beside).converged(experiment, scales)
    gap = measured_gap(experiment, decision.chosen, achievable)
    if not decision.named or gap.after < gap.tuned:
        return decision, gap
    return decision.refuted(experiment.tuned), measured_gap(experiment, experiment.tuned, achievable)


def measured_gap(experiment: Experiment, chosen: Evaluation, achievable: Achievable) -> Gap:
    """The gap of an experiment with the effects of `chosen`."""
    three = (experiment.nominal, experiment.tuned, chosen)
    judged = experiment.judged
    if experiment.by == "inverse dynamics":
        residuals = [judged.residual([judged.row(e.fit.effects, e.fit.deviations)])[0] for e in three]
        errors = [torque_errors(judged, residual) for residual in residuals]
        share = achievable.beside(chosen).rms / max(chosen.rms, 1e-12)
        return _gap("inverse dynamics", errors, errors[2].signals * min(share, 1.0))
    model = achievable.model(chosen.fit)
    if not follows(judged.device):
        residuals = [judged.residual([judged.row(e.fit.effects, e.fit.deviations)])[0] for e in three]
        errors = [segment_errors(judged, residual) for residual in residuals]
        reached = segment_errors(judged, model.residual(judged, model.functions(judged)))
        return _gap("segments", errors, reached.signals)

    def free(deviations: Array, effects: Sequence[Effect]) -> Errors:
        device = repaired_device(judged.device, judged.nuisances, deviations)
        return free_errors(device, effects, experiment.segments, experiment.held)

    errors = [free(each.fit.deviations, each.fit.effects) for each in three]
    repaired = repaired_device(judged.device, judged.nuisances, chosen.fit.deviations)
    driven = [model.driven(each) for each in experiment.segments]
    reached = free_errors(repaired, chosen.fit.effects, driven, experiment.held)
    return _gap("free run", errors, reached.signals)


def _gap(by: By, errors: Sequence[Errors], reached: Array) -> Gap:
    """Of errors before, tuned and after, and what a flexible model leaves of each signal."""
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
    """(before - after) / (before - bound); 1 where there was nothing to explain."""
    possible = before - bound
    return 1.0 if possible <= 1e-12 else float((before - after) / possible)
