"""All figures of one report: missing torque, errors and traces of held-out data, and the causes compared."""

from __future__ import annotations

from via_gap.logs.log import JointLog
from via_gap.report.error_figures import error_figures, trace_figures
from via_gap.report.figures import Figures, JointSketch
from via_gap.report.simulated_intervals import (
    SimulatedInterval,
    free_intervals,
    segment_intervals,
    torque_intervals,
)
from via_gap.report.torque_figures import missing_torques, order_spectra, periodic, residual_figures
from via_gap.report.trial_figures import screened_members, trial_figures, untried_effects
from via_gap.selection.comparison import ModelComparison
from via_gap.selection.evidence import Evaluation
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import By
from via_gap.selection.verdict import Decision

LONGEST: dict[By, float] = {"segments": 2.0, "free run": 5.0, "inverse dynamics": 5.0}  # [s] of a trace


def evidence_figures(comparison: ModelComparison, decision: Decision, by: By) -> Figures:
    """All figures of one diagnosis; `by` is how the gap was measured."""
    experiment, candidates, models = comparison.experiment, comparison.candidates, comparison.models
    missing = missing_torques(experiment.segments, experiment.nominal.fit, decision.chosen.fit)
    intervals = _intervals(experiment, decision.chosen, by)
    transmissions = experiment.evaluated.device.n_transmissions
    compared = [location for location, _ in decision.shares]
    return Figures(
        joint=joint_sketch(experiment.segments[0].log),
        residuals=residual_figures(missing, transmissions),
        spectra=order_spectra(missing) if periodic([*decision.named, *compared]) else (),
        errors=error_figures(intervals, transmissions),
        traces=trace_figures(intervals, LONGEST[by]),
        trials=trial_figures(models, experiment.tuned),
        screened=screened_members(candidates.locations, models) if models else (),
        untried=untried_effects((*candidates.locations, *decision.twins)),
    )


def _intervals(experiment: Experiment, chosen: Evaluation, by: By) -> list[SimulatedInterval]:
    """Held-out data before and after the repair, in the view in which the gap was measured."""
    data = experiment.evaluated
    if by == "free run":
        repaired = data.repaired(chosen.fit.offsets)
        return free_intervals(data.device, repaired, chosen.fit.effects, experiment.segments, experiment.held)
    two = data.residual([data.row(e.fit.effects, e.fit.offsets) for e in (experiment.nominal, chosen)])
    return (segment_intervals if by == "segments" else torque_intervals)(data, *two)


def joint_sketch(log: JointLog) -> JointSketch:
    """The data of the picture of a log's joint."""
    return JointSketch(
        arrangement=log.device.arrangement,
        drive="servo" if log.device.drive == "servo" else "torque",
        motors_seen=log.motors_seen,
        torque_seen=log.torque_seen,
    )
