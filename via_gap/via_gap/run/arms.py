"""Arms of rigid joints: each joint is diagnosed alone, with the torque of the rest of the arm as a known input.

The rigid bodies (arm_model.py) give the torques that the measured motion of all joints requires. Beyond inertia and
gravity of its own device file, the rest of the arm acts on joint i with

    tau_arm,i = M_i qdd_i + g_i(q_i) - [M(q) qdd + c(q, qd) + g(q)]_i

as the command channel `arm_torque`. The diagnosis of one joint is used unchanged. A missing torque T is part of the
measured qdd, so that M_i (qdd - qdd_simulated) = T for any M_i: fitted sizes are unbiased although the joint's inertia
changes with the arm's pose (docs/adr/0006). The angle of the next joint, of the last one that of the joint before, is
the channel `neighbour`.

What all joints share is estimated first, from all of them: a payload or other gravity (arm_cause.py). Each joint
alone would take it for an error of its own drive.

    arm = find_arm("dfki_double_pendulum", recording)
    found = diagnose_arm(arm, [run], [held_out])         # found.causes, and found.reports: one per joint, base first
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Signals

from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport
from via_gap.run.arm_cause import ArmCause, find_causes, read_cause, with_causes
from via_gap.run.arm_model import Arm, find_arm, smoothed_motion

__all__ = [
    "ArmCause",
    "ArmDiagnosis",
    "arm_logs",
    "diagnose_arm",
    "find_arm",
    "read_arm_log",
    "read_cause",
    "with_causes",
]

UNITS = {"external_torque": "N m", "neighbour": "rad", "arm_torque": "N m"}


def read_arm_log(path: str | Path, arm: Arm) -> list[JointLog]:
    """One log per joint of a recording of the whole arm, base first. Raises SignalError where a joint is missing."""
    return arm_logs([read_log(path, device) for device in arm.devices], arm)


def arm_logs(logs: Sequence[JointLog], arm: Arm) -> list[JointLog]:
    """Logs of all joints, recorded together, with the channels `arm_torque` and `neighbour` added."""
    time = logs[0].measured.time
    for log in logs:
        if len(log.measured) != len(time) or not np.array_equal(log.measured.time, time):
            raise SignalError(f"{log.name}: '{log.device.name}' was not recorded with the rest of the arm")
        if log.torque is None and not log.motors_commanded:
            raise SignalError(f"{log.name}: neither torque nor goal of the drive of '{log.device.name}' was recorded")
    angle, velocity, acceleration = smoothed_motion(time, np.stack([log.measured["q"] for log in logs], axis=1))
    whole = arm.torques(angle, velocity, acceleration)
    made = []
    for i, log in enumerate(logs):
        link = log.device.link
        own = link.inertia * acceleration[:, i] + link.gravity_torque * np.sin(angle[:, i] - link.gravity_angle)
        sent = Signals(time, {}, {}) if log.commands is None else log.commands.resample(time)
        known = {"arm_torque": own - whole[:, i]}
        if len(logs) > 1:
            known["neighbour"] = angle[:, i + 1 if i + 1 < len(logs) else i - 1]
        channels = {**sent.channels, **known}
        units = {name: unit for name, unit in {**sent.units, **UNITS}.items() if name in channels}
        commands = Signals(time, channels, units, frozenset(channels))
        made.append(replace(log, commands=commands))
    return made


@dataclass(frozen=True)
class ArmDiagnosis:
    """What an arm lacks: causes that all joints feel, the clearest first, and one report per joint, base first."""

    causes: tuple[ArmCause, ...]
    reports: tuple[GapReport, ...]


def diagnose_arm(
    arm: Arm,
    logs: Sequence[Sequence[JointLog]],
    holdout: Sequence[Sequence[JointLog]] = (),
    progress: Callable[[str, float], None] | None = None,
) -> ArmDiagnosis:
    """The answer for recordings of the whole arm (each as `read_arm_log` returns it).

    Joints are diagnosed with the causes that all of them feel.
    """
    notify = progress or (lambda _what, _share: None)
    notify("the bodies of the arm", 0.0)
    causes = find_causes(arm, logs, holdout)
    if causes:
        loaded = with_causes(arm, causes)
        logs, holdout = ([arm_logs(run, loaded) for run in runs] for runs in (logs, holdout))

    def diagnosed(i: int, device: Device) -> GapReport:
        def report_share(what: str, share: float) -> None:
            notify(f"{device.name}: {what}", (i + share) / len(arm.devices))

        own, held = [run[i] for run in logs], [run[i] for run in holdout]
        return diagnose(own, device, held or None, report_share, only_equations=True)

    return ArmDiagnosis(causes, tuple(diagnosed(i, device) for i, device in enumerate(arm.devices)))
