"""Diagnosis of the gap between logs and a nominal device. docs/method.md explains the stages in this order.

1. recordings   noise and quality of each log; logs that can be used are cut into segments
2. experiment   held-out segments; the view that compares models; the fitted device parameters
3. candidates   every effect at every location of the device, with typical sizes in these logs
4. comparison   search for models: effects are added, exchanged and dropped by their held-out error
5. decision     achievable error; verdict, named effects, ranking and ties; the gap before and after
                if simulation names no cause: steps 3 to 5 by inverse dynamics
                if the gap begins or ends in the log: steps 2 to 5 for the part in which it is larger
6. report       the numbers, the sites of the gap, sensor errors, and what the logs cannot show
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits
from via_core.devices import Device

from via_gap.logs.log import JointLog
from via_gap.report.assembly import full_report, refusal_report
from via_gap.report.report import GapReport
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import candidates_of, compare_models
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import Result, decide_and_measure
from via_gap.selection.search import MOST, Progress
from via_gap.selection.second_view import most_effects, second_view, upheld
from via_gap.selection.turn import part_of
from via_gap.sensors.stamps import separate_delays, with_late_angle


# Threads of linear algebra wait by spinning, which takes the cores from the kernels (residual/threads.py).
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    logs: Sequence[JointLog],
    device: Device,
    holdout: Sequence[JointLog] | None = None,
    progress: Progress | None = None,
    groups: Mapping[str, Hashable] | None = None,
    only_equations: bool = False,
) -> GapReport:
    """Location, cause and size of the gap between `logs` and the nominal `device`.

    holdout         logs to compare models on; without them, segments of `logs` are held out. With them and servos, each
                    log is one run, and causes are chosen by cross-validation over `logs` alone
    progress        called with the current stage and the share of the whole that is done [0..1]
    groups          group of each log by its name; logs of one group are left out together in cross-validation.
                    Without it, each log is a group
    only_equations  compare models by inverse dynamics alone: for the joints of an arm

    Raises SignalError if `logs` is empty. A log that cannot be used is a finding in the report.
    """
    notify = progress or (lambda _what, _share: None)
    notify("checking the recordings", 0.0)
    recordings = Recordings.of(logs, holdout, device)
    if recordings.refused:
        return refusal_report(recordings)
    notify("fitting the device parameters", 0.05)
    experiment = Experiment.of(recordings.fitted, recordings.held_out, groups, only_equations)
    found = _result(recordings, experiment, notify)
    if part := part_of(experiment, found.decision):
        notify("diagnosing the part with the larger gap", 0.9)
        alone = Experiment.of([part.segments], (), None, only_equations)
        inside = _result(recordings, alone, lambda _what, _share: None)
        if inside.decision.named and part.confines(inside.decision.chosen.fit):
            found = replace(inside, part=(part.log, part.begin, part.end))
    notify("writing the report", 0.98)
    report = full_report(recordings, found)
    notify("done", 1.0)
    return report


def _result(recordings: Recordings, experiment: Experiment, notify: Progress) -> Result:
    """The result of an experiment; if simulation names no cause, that by inverse dynamics."""
    found = _decided(recordings, experiment, notify)
    if torques := second_view(experiment, found.decision):
        notify("comparing torques", 0.9)
        other = _decided(recordings, torques, lambda _what, _share: None, most_effects(found.decision))
        if upheld(experiment, found.decision, other.decision):
            return other
    return found


def _decided(recordings: Recordings, experiment: Experiment, notify: Progress, most: int = MOST) -> Result:
    """Candidates, comparison and decision of one experiment; models have at most `most` effects."""
    notify("locating the gap", 0.15)
    comparison = compare_models(experiment, candidates_of(experiment), notify, most)
    models, findings = separate_delays(recordings.logs, comparison.models)
    notify("deciding", 0.85)
    result = decide_and_measure(replace(comparison, models=models), findings)
    return replace(result, decision=with_late_angle(result.decision, recordings.logs[0]))
