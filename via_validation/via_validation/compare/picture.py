"""Picture of the comparison: error, coverage and convergence against noise, and a few seconds of stiffness."""

from __future__ import annotations

from math import isfinite
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import STYLE, save_figure
from via_core.metrics import WIDTH_95

from via_validation.compare import decision
from via_validation.compare.looks import LOOKS
from via_validation.compare.run import WRONG_LEVEL, Comparison

SHOWN = (20.0, 24.0)  # [s] of the stiffness drawn
NEVER = "#c8c8c8"


def draw(comparison: Comparison, path: Path) -> None:
    """Draw a column per joint: error and coverage over noise, and the stiffness of default and best method."""
    devices, names = comparison.devices, [level.name for level in comparison.levels]
    shown = WRONG_LEVEL if WRONG_LEVEL in names else names[-1]
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(
            3, len(devices), figsize=(4.4 * len(devices) + 0.6, 10.5), constrained_layout=True, squeeze=False,
            sharey="row" if len(devices) > 1 else False,
        )  # fmt: skip
        for column, device in enumerate(devices):
            top, middle, bottom = panels[:, column]
            for method in comparison.methods:
                cases = [comparison.case(method, device, name) for name in names]
                top.semilogy(range(len(names)), [100.0 * case.figures.accuracy for case in cases], **LOOKS[method])
                held = [case.figures.coverage if isfinite(case.figures.coverage) else np.nan for case in cases]
                middle.plot(range(len(names)), held, **LOOKS[method])
            middle.axhspan(decision.HONEST, 1.0, color=NEVER, alpha=0.4, linewidth=0)
            middle.set_ylim(-0.03, 1.03)
            top.set_title(device, fontsize=12)
            for axes in (top, middle):
                axes.set_xticks(range(len(names)), names)
            _stiffness(bottom, comparison, device, shown)
        panels[0][0].set_ylabel("relative RMS error [%]")
        panels[1][0].set_ylabel("share in the 95 % interval")
        panels[2][0].set_ylabel(f"stiffness over its mean,\n{shown} noise")
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=10)
        save_figure(figure, path)


def _stiffness(axes: plt.Axes, comparison: Comparison, device: str, level: str) -> None:
    """Stiffness of the best method and, if it is another, of the default, with their 95 % intervals."""
    cases = [decision.best(comparison.of(device, level))]
    default = decision.default_case(comparison, device, level)
    cases += [default] if default and default.method != cases[0].method else []
    part = (cases[0].example.time >= SHOWN[0]) & (cases[0].example.time <= SHOWN[1])
    mean = float(np.mean(cases[0].example.truth[part]))
    for case in cases:
        colour, run = LOOKS[case.method]["color"], case.example
        value, half = run.value[part] / mean, WIDTH_95 * (run.sd[part] / mean)
        axes.plot(run.time[part], value, color=colour, linewidth=1.3, label=case.method)
        axes.fill_between(run.time[part], value - half, value + half, color=colour, alpha=0.2, linewidth=0)
    truth = cases[0].example
    axes.plot(truth.time[part], truth.truth[part] / mean, color="black", linestyle="--", label="truth")
    reach = float(np.max(truth.truth[part])) / mean
    axes.set_ylim(-0.2 * reach, 1.3 * reach)
    axes.set_xlabel("time [s]")
    axes.legend(fontsize=9)
