"""All figures of one report: missing torque, errors and traces of held-out data, and the causes compared."""

from __future__ import annotations

from collections.abc import Sequence

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.logs.log import JointLog
from via_gap.report.error_figures import error_figures, trace_figures
from via_gap.report.figures import Figures, JointSketch
from via_gap.report.simulated_stretches import (
    SimulatedStretch,
    free_stretches,
    segment_stretches,
    torque_stretches,
)
from via_gap.report.torque_figures import missing_torques, order_spectra, periodic, residual_figures
from via_gap.report.trial_figures import screened_members, trial_figures, untried_effects
from via_gap.residual.repaired_device import repaired_device
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import By
from via_gap.selection.verdict import Decision

LONGEST: dict[By, float] = {"segments": 2.0, "free run": 5.0, "inverse dynamics": 5.0}  # [s] of a trace


def evidence_figures(
    experiment: Experiment, candidates: CandidateSet, decision: Decision, models: Sequence[Evaluation], by: By
) -> Figures:
    """All figures of one diagnosis; `by` is how the gap was measured."""
    missing = missing_torques(experiment.segments, experiment.nominal.fit, decision.chosen.fit)
    stretches = _stretches(experiment, decision.chosen, by)
    transmissions = experiment.judged.device.n_transmissions
    compared = [location for location, _ in decision.shares]
    return Figures(
        joint=_joint_sketch(experiment.segments[0].log),
        residuals=residual_figures(missing, transmissions),
        spectra=order_spectra(missing) if periodic([*decision.named, *compared]) else (),
        errors=error_figures(stretches, transmissions),
        traces=trace_figures(stretches, LONGEST[by]),
        trials=trial_figures(models, experiment.tuned),
        screened=screened_members(candidates.locations, models) if models else (),
        untried=untried_effects(candidates.locations),
    )


def joint_only(log: JointLog) -> Figures:
    """The figures of a report without a diagnosis: the picture of the log's joint."""
    return Figures(joint=_joint_sketch(log))


def _stretches(experiment: Experiment, chosen: Evaluation, by: By) -> list[SimulatedStretch]:
    """Held-out data before and after the repair, simulated or judged as the gap was measured."""
    judged = experiment.judged
    if by == "free run":
        repaired = repaired_device(judged.device, judged.nuisances, chosen.fit.deviations)
        return free_stretches(judged.device, repaired, chosen.fit.effects, experiment.segments, experiment.held)
    two = judged.residual([judged.row(e.fit.effects, e.fit.deviations) for e in (experiment.nominal, chosen)])
    return (segment_stretches if by == "segments" else torque_stretches)(judged, *two)


def _joint_sketch(log: JointLog) -> JointSketch:
    return JointSketch(
        arrangement=log.device.arrangement,
        drive="servo" if log.device.drive == "servo" else "torque",
        motors_seen=log.motors_seen,
        torque_seen=log.torque_seen,
    )
