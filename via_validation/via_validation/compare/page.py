"""The comparison as one table, one picture, one page, and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import STYLE
from via_controllers.joints.multisine import Multisine

from via_validation.compare.experiment import EQUILIBRIUM, PRESET
from via_validation.compare.figures import CONVERGED, START, WITHIN
from via_validation.compare.run import WRONG_LEVEL, Case, Comparison
from via_validation.provenance import Provenance
from via_validation.tables.page import small_copy
from via_validation.template import rendered

COLOURS = ("#d1495b", "#1b4965", "#2a7f62", "#e8871e", "#7d5ba6", "#5a5a5a", "#00a6a6", "#9c6644")
SHOWN = (20.0, 24.0)  # [s] of the stiffness drawn
TITLES = ("method", "noise", "error [%] {}", "converged [s]", "in 95 % interval", "sd / scatter", "sd / error",
          "OK [%]", "wrong motors [%]", "cost [us]")  # fmt: skip


def titles(comparison: Comparison) -> list[str]:
    """Column titles of `table_rows`, with one column of accuracy per joint."""
    return [each.format(device) for each in TITLES for device in (comparison.devices if "{}" in each else ("",))]


def table_rows(comparison: Comparison) -> Iterator[list[str]]:
    """One row of cells per method and level; except for accuracy, cells are the worst or the range over all joints."""
    for method in comparison.methods:
        for level in comparison.levels:
            cases = [comparison.case(method, device, level.name) for device in comparison.devices]
            wrong = [case.wrong_motors for case in cases if case.wrong_motors is not None]
            yield [
                method,
                level.name,
                *(_percent(case.figures.accuracy) for case in cases),
                _seconds(max(case.figures.convergence for case in cases)),
                _range(cases, lambda case: case.figures.coverage),
                _range(cases, lambda case: case.figures.over_scatter),
                _range(cases, lambda case: case.figures.over_error),
                _percent(min(case.figures.trusted for case in cases)),
                _percent(max(wrong)) if wrong else "",
                f"{comparison.cost[method]:.1f}" if level is comparison.levels[0] else "",
            ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g}" if isfinite(share) else "-"


def _seconds(value: float) -> str:
    return f"{value:.0f}" if isfinite(value) else "never"


def _range(cases: list[Case], figure: Callable[[Case], float]) -> str:
    values = [value for value in map(figure, cases) if isfinite(value)]
    if not values:
        return "-"
    low, high = (f"{float(f'{value:.2g}'):g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} .. {high}"


def as_json(comparison: Comparison, source: Provenance) -> dict[str, Any]:
    """Everything except the examples; infinite and missing numbers are null."""

    def number(value: float | None) -> float | None:
        return value if value is not None and isfinite(value) else None

    return {
        "provenance": vars(source),
        "seeds": comparison.seeds,
        "levels": {level.name: str(level) for level in comparison.levels},
        "cost_us": comparison.cost,
        "cases": [
            {
                "method": case.method,
                "device": case.device,
                "level": case.level,
                **{name: number(value) for name, value in vars(case.figures).items()},
                "wrong_motors": number(case.wrong_motors),
            }
            for case in comparison.cases
        ],
    }


def draw(comparison: Comparison, path: Path) -> None:
    """Draw a column per joint: accuracy over noise, and a few seconds of stiffness at the realistic level."""
    devices, names = comparison.devices, [level.name for level in comparison.levels]
    shown = WRONG_LEVEL if WRONG_LEVEL in names else names[-1]
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(
            2, len(devices), figsize=(4.4 * len(devices) + 0.6, 7.6), constrained_layout=True, squeeze=False
        )
        for column, device in enumerate(devices):
            top, bottom = panels[:, column]
            for method, colour in zip(comparison.methods, COLOURS, strict=False):
                cases = [comparison.case(method, device, name) for name in names]
                accuracies = [100.0 * case.figures.accuracy for case in cases]
                top.semilogy(range(len(names)), accuracies, "o-", color=colour, label=method)
                example = comparison.case(method, device, shown).example
                part = (example.time >= SHOWN[0]) & (example.time <= SHOWN[1])
                bottom.plot(example.time[part], example.value[part], color=colour, linewidth=1.3)
            bottom.plot(example.time[part], example.truth[part], color="black", linestyle="--", label="truth")
            reach = float(np.max(example.truth[part]))
            bottom.set_ylim(-0.2 * reach, 1.5 * reach)
            top.set_title(device, fontsize=12)
            top.set_xticks(range(len(names)), names)
            bottom.set_xlabel("time [s]")
        limits = [limit for axes in panels[0] for limit in axes.get_ylim()]
        for axes in panels[0]:
            axes.set_ylim(min(limits), max(limits))
        panels[0][0].set_ylabel("relative RMS error [%]")
        panels[1][0].set_ylabel(f"total stiffness [N m/rad],\n{shown} noise")
        panels[1][0].legend(fontsize=10)
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=10)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
        plt.close(figure)


def write_markdown(comparison: Comparison, picture: Path, source: Provenance, path: Path) -> None:
    """Write the page, with a small copy of the picture beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    target = path.with_suffix(".png")
    small_copy(picture, target)
    values = {
        "c": comparison,
        "titles": titles(comparison),
        "rows": list(table_rows(comparison)),
        "source": source,
        "picture": target.name,
        "equilibrium": _tones(EQUILIBRIUM),
        "preset": _tones(PRESET),
        "converged": CONVERGED,
        "start": START,
        "within": 100.0 * WITHIN,
        "wrong_level": WRONG_LEVEL,
    }
    path.write_text(rendered("compare/page.md", values), encoding="utf-8")


def _tones(reference: Multisine) -> str:
    amplitudes, frequencies = (
        ", ".join(f"{x:g}" for x in part) for part in (reference.amplitudes, reference.frequencies)
    )
    return f"{reference.mean:g} rad with tones of {amplitudes} rad at {frequencies} Hz"
