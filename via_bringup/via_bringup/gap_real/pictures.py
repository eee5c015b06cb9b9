"""Pictures of the two real robots: held-out runs before and after, and the torque that equations lack over speed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt

from via_bringup.demo.pictures import STYLE
from via_bringup.gap_real.run import ArmJoint, Joint
from via_bringup.tables.page import small_copy

REAL, PUBLISHED, REPAIRED = "#1b4965", "#d1495b", "#2a7f62"


def draw_joint(joint: Joint, path: Path) -> None:
    """Six held-out runs from worst to best after the repair."""
    ordered = sorted(joint.held, key=lambda run: -run[2].nrmse)
    shown = [ordered[round(i * (len(ordered) - 1) / 5)] for i in range(min(6, len(ordered)))]
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 3, figsize=(11, 6.4), sharex=True, constrained_layout=True)
        for axes, (name, before, after) in zip(panels.flat, shown, strict=False):
            axes.plot(before.time, before.measured, color=REAL, label="real robot")
            axes.plot(before.time, before.simulated, color=PUBLISHED, linestyle="--", label="published model")
            axes.plot(after.time, after.simulated, color=REPAIRED, label="with the effects named")
            axes.set_title(f"{name}: {before.nrmse:.2f} -> {after.nrmse:.2f}", fontsize=11)
        for axes in panels[:, 0]:
            axes.set_ylabel("joint angle q [rad]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        panels.flat[0].legend(fontsize=9)
        _save(figure, path)


def draw_arm(joints: Sequence[ArmJoint], path: Path) -> None:
    """Missing torque of each joint over its speed, without and with what was named."""
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(1, len(joints), figsize=(11, 4.6), constrained_layout=True)
        for axes, joint in zip(panels, joints, strict=True):
            axes.plot(joint.speed, joint.before, ".", markersize=2, color=PUBLISHED, label="nominal, friction left out")
            axes.plot(joint.speed, joint.after, ".", markersize=2, color=REPAIRED, label="with the effects named")
            axes.set_title(joint.device.name, fontsize=12)
            axes.set_xlabel("joint velocity [rad/s]")
        panels[0].set_ylabel("torque the model lacks [N m]")
        panels[0].legend(fontsize=9, markerscale=5)
        _save(figure, path)


def _save(figure: plt.Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
    small_copy(path, path)
