"""The report, put together from the results of the stages; every part follows from one decision."""

from __future__ import annotations

import numpy as np

from via_gap.logs.between import lines_finding
from via_gap.report import context
from via_gap.report.answer import answer
from via_gap.report.evidence_figures import evidence_figures, joint_sketch
from via_gap.report.figures import Figures
from via_gap.report.report import GapReport, LogInterval
from via_gap.residual.recordings import Recordings
from via_gap.selection.gap import Result
from via_gap.sensors.sensor_errors import sensor_errors


def refusal_report(recordings: Recordings) -> GapReport:
    """The report on recordings that cannot be diagnosed, with the findings that state why."""
    refusals = [each.text for each in recordings.findings if each.severity == "refuse"]
    return GapReport(
        joint=recordings.device.name, level=recordings.first.level, logs=recordings.names,
        holdout=context.holdout_names(recordings), verdict="cannot_tell",
        reason=recordings.unusable or next(iter(refusals), ""), where=(), causes=(), equivalence_set=(), effects=(),
        gap=None, nuisance=(), data_check=recordings.findings, noise=context.channel_noise(recordings),
        not_evaluated=context.not_evaluated(recordings.first),
        figures=Figures(joint=joint_sketch(recordings.first)),
    )  # fmt: skip


def full_report(recordings: Recordings, result: Result) -> GapReport:
    """The report on a decision, and on errors that the sensors' own measurements show."""
    comparison, decision, gap, part = result.comparison, result.decision, result.gap, result.part
    experiment = comparison.experiment
    sensors = sensor_errors(recordings.logs)
    lines = [lines_finding(each.log) for each in experiment.segments if each.log.lined is not None]
    said = answer(recordings.first.level, comparison, decision, sensors)
    report = GapReport(
        joint=recordings.device.name, level=recordings.first.level, logs=recordings.names,
        holdout=context.holdout_names(recordings), reason=decision.reason if said.verdict == "cannot_tell" else "",
        explained=float(np.clip(decision.explained, 0.0, 1.0)), gap=gap,
        nuisance=context.fitted_parameters(experiment.fitted, decision.chosen.fit.offsets),
        lined=experiment.segments[0].log.lined, widened=decision.widened, transfer=dict(decision.transfer),
        halves=_halves(result),
        data_check=(*recordings.findings, *result.findings, *lines), noise=context.channel_noise(recordings),
        not_evaluated=context.not_evaluated(recordings.first),
        figures=evidence_figures(comparison, decision, gap.by),
        held_out=context.held_out_intervals(experiment.segments, experiment.held),
        part=None if part is None else LogInterval(log=part[0], begin=part[1], end=part[2]),
        **vars(said),
    )  # fmt: skip
    return GapReport.model_validate(report.model_dump())


def _halves(result: Result) -> dict[str, tuple[float, float]]:
    """Parameters of the main effect, fitted to the halves between which it transfers worst; empty without any."""
    if not result.decision.halves:
        return {}
    low, high = (each.effects[0].parameters for each in result.decision.halves)
    return {name: (low[name], high[name]) for name in low}
