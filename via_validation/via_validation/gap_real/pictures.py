"""Picture of the real robots: the gap on held-out data before and after the repair, one line per case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from via_bringup.demo.pictures import STYLE, save_figure

from via_validation.gap_real.summary import Pair, outcome_of
from via_validation.tables.page import small_copy

FILED, REPAIRED, FLOOR = "#d1495b", "#2a7f62", "#9aa5b1"
LEAST = 1e-6  # smallest gap on the logarithmic axis, far below the resolution of any encoder


def draw_gaps(pairs: Sequence[Pair], path: Path) -> None:
    """Draw the gap before and after the repair of every case that has one."""
    shown = [(case, result, result.report.gap) for case, result in pairs if result.report and result.report.gap]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(10, 1.5 + 0.28 * len(shown)), constrained_layout=True)
        for row, (_, _, gap) in enumerate(shown):
            before, after, floor = (max(each, LEAST) for each in (gap.before, gap.after, gap.floor))
            label = row == 0
            axes.plot([before, after], [row, row], color=FLOOR, linewidth=1.5, zorder=1)
            axes.plot(floor, row, "|", color=FLOOR, markersize=9, label="sensors alone" if label else None)
            axes.plot(before, row, "o", color=FILED, label="nominal device" if label else None)
            axes.plot(after, row, "o", color=REPAIRED, label="with the repair" if label else None)
        names = [f"{case.name} ({outcome_of(case, result)})" for case, result, _ in shown]
        axes.set_yticks(range(len(shown)), names, fontsize=9)
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlabel("error on held-out data over the standard deviation of the signal [-]")
        if shown:
            axes.legend(fontsize=9)
        save_figure(figure, path)
    small_copy(path, path)
