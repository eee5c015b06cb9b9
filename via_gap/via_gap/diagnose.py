"""Logs and a nominal device in, a GapReport out: the stages by name. docs/method.md explains each in this order.

1. recordings   what was recorded, how noisy it is, and whether it can answer at all
2. experiment   segments, those held out among them; the view that judges; the device's own numbers fitted
3. candidates   every effect at every location the device can have, with typical sizes in these logs
4. comparison   models searched: effects added, exchanged and dropped by what they explain of held-out segments
5. decision     what could be explained at best; verdict, named effects, ranking and ties; the gap before and after
6. report       the numbers, where the gap lies, errors of sensors, and what was not judged
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

from via_core.devices import Device
from via_core.errors import SignalError

from via_gap.candidates.candidate_set import CandidateSet
from via_gap.logs.log import JointLog
from via_gap.report.assembly import answered, unanswered
from via_gap.report.report import GapReport
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import compared
from via_gap.selection.experiment import Experiment
from via_gap.selection.gap import decided
from via_gap.selection.search import Progress
from via_gap.sensors.stamps import separate_delays


def diagnose(
    logs: Sequence[JointLog],
    device: Device,
    holdout: Sequence[JointLog] | None = None,
    progress: Progress | None = None,
    groups: Mapping[str, Hashable] | None = None,
    only_equations: bool = False,
) -> GapReport:
    """Where the gap between `logs` and the nominal `device` lies, what causes it, and how far it shrinks.

    holdout         logs to judge on; without them stretches of `logs` are held out. Where motors follow their commands,
                    each log is one run, and causes are chosen by cross-validation over `logs` alone
    progress        called with what is being done and how much of the whole is done [0..1]
    groups          of logs, by their names: logs of one group never judge one another. Each its own if left out
    only_equations  inverse dynamics judges alone: for the joints of an arm

    Raises SignalError for no log at all. A log that cannot be used is a finding in the report.
    """
    if not logs:
        raise SignalError("no log to diagnose")
    notify = progress or (lambda _what, _share: None)
    notify("checking the recordings", 0.0)
    recordings = Recordings.of(logs, holdout, device)
    if recordings.refused:
        return unanswered(recordings)
    notify("fitting the device's own numbers", 0.05)
    experiment = Experiment.of(recordings.fitted, recordings.judged, groups, only_equations)
    notify("locating the gap", 0.15)
    candidates = CandidateSet.of(experiment.segments, experiment.train, experiment.tuned.fit, experiment.fitted)
    experiment, candidates, models = compared(experiment, candidates, notify)
    models, findings = separate_delays(recordings.logs, models)
    notify("deciding", 0.85)
    decision, gap = decided(experiment, models, candidates.scales)
    notify("writing the report", 0.98)
    report = answered(recordings, experiment, candidates, models, decision, gap, findings)
    notify("done", 1.0)
    return report
