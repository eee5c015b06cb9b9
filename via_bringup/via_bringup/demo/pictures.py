"""Pictures of the demo: functions that take arrays and write PNG files."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from via_core.metrics import WIDTH_95
from via_core.signals import Array
from via_gap.logs.replay import Gap

REAL, MODEL, REFERENCE, FAINT = "#1b4965", "#d1495b", "#5a5a5a", "#9aa5b1"

SMALL = (6.2, 2.7)  # [in] of a picture on the first screen
STYLE = {
    "font.size": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "savefig.dpi": 110,
}


@dataclass(frozen=True)
class Band:
    """An estimate over time with its reference."""

    time: Array  # (N,) [s]
    value: Array  # (N,)
    standard_deviation: Array  # (N,)
    reference: Array  # (N,)
    trusted: Array  # (N,) bool: status OK


def estimates(damping: Band, stiffness: Band, path: Path) -> None:
    """Damping and stiffness of one run over time, each with its 95 % band and its reference."""
    with plt.rc_context({**STYLE, "font.size": 9}):
        figure, panels = plt.subplots(1, 2, figsize=SMALL, constrained_layout=True)
        for axes, band, label in zip(
            panels, (damping, stiffness), ("damping [N m s/rad]", "stiffness [N m/rad]"), strict=True
        ):
            _band(axes, band, "model", "")
            axes.get_legend().remove()
            axes.set(title=label, xlabel="time [s]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=8)
        save_figure(figure, path)


def angles(gap: Gap, path: Path) -> None:
    """Measured and simulated joint angle of one run."""
    with plt.rc_context({**STYLE, "font.size": 9}):
        figure, axes = plt.subplots(figsize=SMALL, constrained_layout=True)
        axes.plot(gap.time - gap.time[0], gap.measured, color=REAL, label="measured")
        axes.plot(gap.time - gap.time[0], gap.simulated, color=MODEL, linestyle="--", label="model")
        axes.set(xlabel="time [s]", ylabel="joint angle [rad]")
        _legend(axes)
        save_figure(figure, path)


def shares(values: Mapping[str, float], marked: Collection[str], label: str, path: Path) -> None:
    """Horizontal bars of shares [-] by name in percent, the first on top; those not `marked` are faint."""
    with plt.rc_context({**STYLE, "font.size": 9, "axes.grid": False}):
        figure, axes = plt.subplots(figsize=SMALL, constrained_layout=True)
        names = list(values)
        lengths = [100.0 * value for value in values.values()]
        bars = axes.barh(names, lengths, color=[REAL if name in marked else FAINT for name in names])
        axes.bar_label(bars, [f"{length:.2g} %" if length >= 0.1 else "below 0.1 %" for length in lengths], padding=3)
        axes.invert_yaxis()
        axes.set(xlabel=label, xlim=(0.0, 1.15 * max(lengths)))
        save_figure(figure, path)


def gap_traces(gaps: Mapping[str, Gap], path: Path) -> None:
    """Real and simulated joint angle of runs by title, one panel per run."""
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 2, figsize=(10, 6.4), sharex=True, constrained_layout=True)
        for axes, (title, gap) in zip(panels.flat, gaps.items(), strict=False):
            time = gap.time - gap.time[0]
            axes.plot(time, gap.measured, color=REAL, label="real robot")
            axes.plot(time, gap.simulated, color=MODEL, linestyle="--", label="published model")
            axes.set_title(f"{title}: NRMSE {gap.nrmse:.2f}", fontsize=12)
            axes.set_ylabel("joint angle q [rad]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        panels.flat[0].legend()
        save_figure(figure, path)


@dataclass(frozen=True)
class Column:
    """The runs of one damping strategy."""

    values: Array  # (N,) one per run
    standard_deviations: Array | None  # (N,)
    level: float  # reference, or pooled value


def by_strategy(columns: Mapping[str, Column], label: str, level: str, path: Path) -> None:
    """All runs by strategy, sorted by value. `label` is the axis label with unit, `level` the legend of the bars."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(8, 4.4), constrained_layout=True)
        for index, column in enumerate(columns.values()):
            order = np.argsort(column.values)
            x = index + (np.linspace(-0.34, 0.34, len(order)) if len(order) > 1 else np.zeros(1))
            bars = None if column.standard_deviations is None else WIDTH_95 * column.standard_deviations[order]
            name = ("one run" if bars is None else "one run, 95 % interval") if index == 0 else None
            axes.errorbar(
                x, column.values[order], yerr=bars, fmt="o", color=REAL, markersize=4, elinewidth=0.8, label=name
            )
            axes.hlines(
                column.level, index - 0.4, index + 0.4, color=MODEL, linewidth=2.5, label=level if index == 0 else None
            )
        axes.set_xticks(range(len(columns)), list(columns))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        axes.set(xlim=(-0.6, len(columns) - 0.4), xlabel="damping strategy", ylabel=label)
        _legend(axes)
        save_figure(figure, path)


def run_in_detail(title: str, gap: Gap, equilibrium: Array, damping: Band, stiffness: Band, path: Path) -> None:
    """Measured angle and commanded equilibrium (N,) [rad], damping and stiffness of one run over time."""
    with plt.rc_context(STYLE):
        figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, constrained_layout=True)
        figure.suptitle(title, fontsize=13)
        time = gap.time - gap.time[0]
        top.plot(time, gap.measured, color=REAL, label="joint angle q")
        top.plot(time, equilibrium, color=REFERENCE, linestyle=":", label="commanded equilibrium")
        top.set_ylabel("angle [rad]")
        _legend(top)
        _band(middle, damping, "commanded", "damping\n[N m s/rad]")
        _band(bottom, stiffness, "spring law of the published model", "stiffness\n[N m/rad]")
        bottom.set_xlabel("time [s]")
        save_figure(figure, path)


def live_joint(time: Array, q: Array, theta: Array, stiffness: Band, path: Path) -> None:
    """The simulated joint: angles, stiffness with its true value, and estimation error; theta is (N, 2) [rad]."""
    with plt.rc_context(STYLE):
        figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(9, 8.4), sharex=True, constrained_layout=True)
        top.plot(time, q, color=REAL, label="link q")
        for motor, style in ((0, "-"), (1, "--")):
            top.plot(time, theta[:, motor], color=FAINT, linestyle=style, label=f"motor {motor + 1}")
        top.set_ylabel("angle [rad]")
        _legend(top)
        _band(middle, stiffness, "truth", "stiffness [N m/rad]")
        error = np.where(stiffness.trusted, stiffness.value - stiffness.reference, np.nan)
        half = np.where(stiffness.trusted, WIDTH_95 * stiffness.standard_deviation, np.nan)
        bottom.fill_between(stiffness.time, -half, half, color=MODEL, alpha=0.2, linewidth=0, label="95 % band")
        bottom.plot(stiffness.time, error, color=MODEL, label="estimate - truth")
        if stiffness.trusted.any():
            reach = 1.1 * np.nanpercentile(np.maximum(half, np.abs(error)), 98)
            bottom.set_ylim(-reach, reach)
        bottom.set(xlabel="time [s]", ylabel="error [N m/rad]")
        _legend(bottom)
        save_figure(figure, path)


def _band(axes: Axes, band: Band, reference: str, label: str) -> None:
    """Estimate with its 95 % band where the status is OK, and faint elsewhere."""
    half = WIDTH_95 * band.standard_deviation
    trusted = np.where(band.trusted, band.value, np.nan)
    axes.plot(band.time, band.value, color=FAINT, linewidth=0.9, label="status not OK")
    axes.plot(band.time, trusted, color=MODEL, label="estimate, 95 % band")
    axes.fill_between(
        band.time, band.value - half, band.value + half, where=band.trusted, color=MODEL, alpha=0.2, linewidth=0
    )
    axes.plot(band.time, band.reference, color=REAL, linestyle="--", label=reference)
    shown = np.concatenate([band.reference, band.value[band.trusted]])
    shown = shown[np.isfinite(shown)]
    if shown.size:
        low, high = np.percentile(shown, [0.5, 99.5])
        margin = 0.3 * max(high - low, 1e-9 + 0.1 * abs(high))
        axes.set_ylim(max(low - margin, 0.0) if low >= 0.0 else low - margin, high + margin)
    axes.set_ylabel(label)
    _legend(axes)


def _legend(axes: Axes) -> None:
    """Legend in one line above the axes, where it covers no curve."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=10, borderaxespad=0.2)


def save_figure(figure: Figure, path: Path, dpi: float | None = None) -> Path:
    """Write and close the figure; makes the folder if necessary. Returns `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    return path
