"""The two diagnoses: a variable-damping joint on trajectories held out, an arm whose dry friction was left out.

Which files are fitted and which are judged was fixed before any result: odd trajectories against even ones (third
repeat of all four damping strategies), the long excitation run against the two short ones. Even trajectories have no
part in choosing effects either: odd ones are judged by fits to others, all four runs of a trajectory left out together.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_core.bags import import_recordings
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_gap.diagnose import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.logs.replay import Gap as Replayed
from via_gap.logs.replay import measure_gap, pooled
from via_gap.report.report import GapReport
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.nuisance import nuisances
from via_gap.residual.repaired_device import repaired_device
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_gap.run.arms import diagnose_arm, load_arm, read_arm_log
from via_sim.plants import JointPlant

DEVICE, ARM = "maccepavd", "dfki_double_pendulum"
REPEAT = "3"
FITTED = "20220812-061157-PM_measured.csv"
JUDGED = ("20220812-055032-PM_measured.csv", "20220812-060143-PM_measured.csv")

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Joint:
    """The MACCEPA-VD. Runs are by name: the log, the published model beside it, the repaired one."""

    report: GapReport
    refused: tuple[str, ...]  # recordings of the chosen repeat that the import refused
    fitted: int
    held: tuple[tuple[str, Replayed, Replayed], ...]

    @property
    def before(self) -> float:
        """NRMSE [-] of all held-out runs together, published model."""
        return pooled([before for _, before, _ in self.held])

    @property
    def after(self) -> float:
        return pooled([after for _, _, after in self.held])


@dataclass(frozen=True, eq=False)
class ArmJoint:
    """One joint of the arm: judged within the fitted run, and on the files held out; torques of windows for pictures.

    speed, before, after  (W,) [rad/s], [N m], [N m] missing torque without and with the effects named within the run
    """

    device: Device
    within: GapReport
    across: GapReport
    speed: Array
    before: Array
    after: Array


def diagnose_joint(folder: Path, progress: Progress) -> Joint:
    """The variable-damping joint, from the folder of its recordings."""
    device = load_device(DEVICE)
    fitted: list[JointLog] = []
    held: list[JointLog] = []
    refused, trajectories = [], {}
    with tempfile.TemporaryDirectory() as bags:
        for file in import_recordings(folder, DEVICE, bags).files:
            found = re.search(rf"traj(\d+)_{REPEAT}\.csv$", file.source)
            if found is None:
                continue
            if file.bag is None:
                refused.append(file.source)
                continue
            log = read_log(file.bag, device)
            (fitted if int(found[1]) % 2 else held).append(log)
            trajectories[log.name] = found[1]
    report = diagnose(fitted, device, held, progress, groups=trajectories)
    moved = np.array([number.deviations for number in report.nuisance])
    repaired = repaired_device(device, nuisances(JointPlant.from_device(device)), moved)
    runs = []
    for log in held:
        assert log.commands is not None
        before = measure_gap(device, log.measured, log.commands)
        runs.append((log.name, before, measure_gap(repaired, log.measured, log.commands, report.repair())))
    return Joint(report, tuple(refused), len(fitted), tuple(runs))


def diagnose_both(folder: Path, progress: Progress) -> tuple[ArmJoint, ...]:
    """Both joints of the double pendulum, from the folder of its recordings."""
    arm = load_arm(ARM)
    fitted = read_arm_log(folder / FITTED, arm)
    judged = [read_arm_log(folder / name, arm) for name in JUDGED]
    within = diagnose_arm(arm, [fitted], (), lambda what, share: progress(what, 0.6 * share))
    across = diagnose_arm(arm, [fitted], judged, lambda what, share: progress(what, 0.6 + 0.4 * share))
    return tuple(
        ArmJoint(log.device, inside, outside, *_missing(log, inside))
        for log, inside, outside in zip(fitted, within, across, strict=True)
    )


def _missing(log: JointLog, report: GapReport) -> tuple[Array, Array, Array]:
    segments = cut_log(log)
    problem = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], InverseDynamics.of)
    view = problem.views[0]
    assert isinstance(view, InverseDynamics)
    moved = np.array([number.deviations for number in report.nuisance])
    before, after = problem.residual([problem.row([]), problem.row(report.repair(), moved)]) * view.windows.floor[0]
    middle = view.first.ravel() + view.windows.weights.shape[1] // 2
    return segments.start[middle, 3], before, after
