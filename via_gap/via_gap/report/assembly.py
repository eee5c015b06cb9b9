"""A report from the results of the stages; every part of it follows from one decision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.logs.between import told
from via_gap.logs.findings import Finding
from via_gap.report import context
from via_gap.report.answer import answer
from via_gap.report.evidence_figures import evidence_figures, joint_only
from via_gap.report.report import GapReport
from via_gap.residual.recordings import Recordings
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import Gap
from via_gap.selection.verdict import Decision
from via_gap.sensors.sensor_errors import sensor_errors


def unanswered(recordings: Recordings) -> GapReport:
    """The report on recordings that cannot answer: what was noticed about them."""
    refusals = [each.text for each in recordings.findings if each.severity == "refuse"]
    return GapReport(
        joint=recordings.device.name, level=recordings.first.level, logs=recordings.names,
        holdout=context.judged_on(recordings), verdict="cannot_tell",
        reason=recordings.unusable or next(iter(refusals), ""), where=(), causes=(), equivalence_set=(), effects=(),
        gap=None, nuisance=(), data_check=recordings.findings, noise=context.channel_noise(recordings),
        not_judged=context.not_judged(recordings.first), figures=joint_only(recordings.first),
    )  # fmt: skip


def answered(
    recordings: Recordings, experiment: Experiment, candidates: CandidateSet, models: Sequence[Evaluation],
    decision: Decision, gap: Gap, findings: Sequence[Finding],
) -> GapReport:  # fmt: skip
    """The report on a decision, and on errors that the sensors' own measurements show."""
    sensors = sensor_errors(recordings.logs)
    report = GapReport(
        joint=recordings.device.name, level=recordings.first.level, logs=recordings.names,
        holdout=context.judged_on(recordings), reason=decision.reason,
        explained=float(np.clip(decision.explained, 0.0, 1.0)), gap=gap,
        nuisance=context.fitted_parameters(experiment.fitted, decision.chosen.fit.deviations),
        lined=experiment.segments[0].log.lined,
        data_check=(*recordings.findings, *findings, *_lined(experiment)), noise=context.channel_noise(recordings),
        not_judged=context.not_judged(recordings.first),
        figures=evidence_figures(experiment, candidates, decision, models, gap.by),
        held_out=context.held_out_stretches(experiment.segments, experiment.held),
        **vars(answer(recordings.first.level, experiment, candidates, decision, sensors)),
    )  # fmt: skip
    return GapReport.model_validate(report.model_dump())


def _lined(experiment: Experiment) -> list[Finding]:
    """What was found out about commands between samples."""
    return [told(each.log) for each in experiment.segments if each.log.lined is not None]
