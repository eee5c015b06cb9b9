"""Pictures of Section 4: Figures 6, 7 and 8."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import MODEL, REAL, STYLE, save_figure
from via_core.signals import Array
from via_core.status import Status

from via_validation.tables.cubic_joint import cubic_log
from via_validation.tables.rows import Progress
from via_validation.tables.section4_methods import MM, cubic, ideal_estimates, smoothed
from via_validation.tables.vsa2 import SLOW, motion


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figures 6, 7 and 8."""
    progress(0, 3, "Figure 6")
    run, found = motion("v1"), ideal_estimates("v1", SLOW)
    titles = {"qr_rls": "proposed: QR-RLS", "batch": "standard LS", "residual": "residual and RLS of [9]"}
    paths = [
        _traces(
            run.time,
            MM * run.stiffness_each[:, 0],
            [(title, MM * found[method]) for method, title in titles.items()],
            "N mm/rad",
            folder / "figure_6.png",
        )
    ]
    progress(1, 3, "Figure 7")
    estimates = smoothed().run_rows(run.noisy(0))[1]
    value = np.where(estimates.status == Status.WARMING_UP, np.nan, MM * estimates.column("stiffness")[0])
    title = "VSA-II, 14 bit, 1 N mm of torque noise: total stiffness"
    paths.append(_traces(run.time, MM * run.stiffness, [(title, value)], "N mm/rad", folder / "figure_7.png"))
    progress(2, 3, "Figure 8")
    cubic_run, estimate = cubic_log("E1"), cubic(1, "E1")[4].copy()
    estimate[cubic_run.rows[:, 0] < 2.0] = np.nan
    title = "antagonistic joint with cubic springs: total stiffness"
    path = folder / "figure_8.png"
    paths.append(_traces(cubic_run.rows[:, 0], cubic_run.stiffness, [(title, estimate)], "N m/rad", path))
    progress(3, 3, "done")
    return paths


def _traces(time: Array, truth: Array, panels: Sequence[tuple[str, Array]], unit: str, path: Path) -> Path:
    """Actual and estimated stiffness over time, one panel per estimate."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(panels), 1, figsize=(9, 1.0 + 2.9 * len(panels)), sharex=True, constrained_layout=True, squeeze=False
        )
        for panel, (title, value) in zip(axes[:, 0], panels, strict=True):
            panel.plot(time, truth, color=REAL, label="actual")
            panel.plot(time, value, color=MODEL, linestyle="--", label="estimated")
            panel.set_title(title, fontsize=12)
            panel.set_ylabel(f"stiffness [{unit}]")
            panel.set_ylim(0.0, 1.25 * truth.max())
        axes[0, 0].legend(loc="upper right", ncols=2)
        axes[-1, 0].set_xlabel("time [s]")
        return save_figure(figure, path)
