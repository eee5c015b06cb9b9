"""The demo's pictures: arrays in, PNG files out; every axis has its unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from via_core.signals import Array

REAL, MODEL, REFERENCE, FAINT = "#1b4965", "#d1495b", "#5a5a5a", "#9aa5b1"

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
class Trace:
    """One run as it was and as the nominal model has it."""

    title: str
    time: Array  # (N,) [s]
    real: Array  # (N,) [rad]
    simulated: Array  # (N,) [rad]
    nrmse: float


@dataclass(frozen=True)
class Band:
    """An estimate over time beside its reference."""

    time: Array  # (N,) [s]
    value: Array  # (N,)
    standard_deviation: Array  # (N,)
    reference: Array  # (N,)
    trusted: Array  # (N,) bool: status OK


def gap_traces(traces: Sequence[Trace], path: Path) -> None:
    """Real and simulated joint angle, one panel per strategy."""
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 2, figsize=(10, 6.4), sharex=True, constrained_layout=True)
        for axes, trace in zip(panels.flat, traces, strict=False):
            axes.plot(trace.time, trace.real, color=REAL, label="real robot")
            axes.plot(trace.time, trace.simulated, color=MODEL, linestyle="--", label="published model")
            axes.set_title(f"{trace.title}: NRMSE {trace.nrmse:.2f}", fontsize=12)
            axes.set_ylabel("joint angle q [rad]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        panels.flat[0].legend()
        _save(figure, path)


def gap_by_strategy(nrmse: Mapping[str, Sequence[float]], overall: float, path: Path) -> None:
    """Every run's NRMSE, a column per strategy."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7, 4.2), constrained_layout=True)
        for column, values in enumerate(nrmse.values()):
            spread = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(1)
            label = "one run" if column == 0 else None
            axes.plot(column + spread, np.sort(values), "o", color=REAL, alpha=0.7, markersize=5, label=label)
            axes.hlines(float(np.mean(values)), column - 0.3, column + 0.3, color=MODEL, linewidth=2.5)
        axes.axhline(overall, color=REFERENCE, linestyle=":", label=f"mean of all runs {overall:.2f}")
        axes.set_xticks(range(len(nrmse)), list(nrmse))
        axes.set_xlim(-0.6, len(nrmse) - 0.4)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("NRMSE of the simulated angle [-]")
        axes.set_xlabel("damping strategy (bar: mean)")
        axes.legend()
        _save(figure, path)


def damping_against_command(
    points: Mapping[str, tuple[Sequence[float], Sequence[float], Sequence[float]]], path: Path
) -> None:
    """Estimated against commanded damping: strategy -> (commanded, estimated, standard deviation) [N m s/rad]."""
    marks = ("o", "s", "^", "D", "v", "P")
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7, 5), constrained_layout=True)
        top = 0.0
        for mark, (strategy, (commanded, estimated, deviation)) in zip(marks, points.items(), strict=False):
            axes.errorbar(
                commanded,
                estimated,
                yerr=1.96 * np.asarray(deviation),
                fmt=mark,
                markersize=5,
                elinewidth=0.8,
                alpha=0.75,
                label=strategy,
            )
            top = max(top, float(np.max(commanded)), float(np.max(estimated)))
        axes.plot([0, 1.1 * top], [0, 1.1 * top], color=REFERENCE, linestyle=":", label="estimate = command")
        axes.set_xlim(0.0, 1.1 * top)
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), 1.3 * top)
        axes.set_xlabel("commanded damping [N m s/rad]")
        axes.set_ylabel("estimated damping [N m s/rad]\n(bar: 95 % interval)")
        axes.legend()
        _save(figure, path)


def run_in_detail(
    title: str, time: Array, q: Array, equilibrium: Array, damping: Band, stiffness: Band, path: Path
) -> None:
    """One run: angle, damping and stiffness over time."""
    with plt.rc_context(STYLE):
        figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, constrained_layout=True)
        top.set_title(title, fontsize=12)
        top.plot(time, q, color=REAL, label="joint angle q")
        top.plot(time, equilibrium, color=REFERENCE, linestyle=":", label="equilibrium")
        top.set_ylabel("angle [rad]")
        top.legend()
        _band(middle, damping, "commanded", "damping\n[N m s/rad]")
        _band(bottom, stiffness, "spring law", "stiffness\n[N m/rad]")
        bottom.set_xlabel("time [s]")
        _save(figure, path)


def live_joint(time: Array, q: Array, theta: Array, stiffness: Band, path: Path) -> None:
    """The simulated joint: angles, and stiffness with its band against the truth; theta is (N, 2)."""
    with plt.rc_context(STYLE):
        figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 6.4), sharex=True, constrained_layout=True)
        top.plot(time, q, color=REAL, label="link q")
        for motor, style in ((0, "-"), (1, "--")):
            top.plot(time, theta[:, motor], color=FAINT, linestyle=style, label=f"motor {motor + 1}")
        top.set_ylabel("angle [rad]")
        top.legend(loc="upper right", ncols=3)
        _band(bottom, stiffness, "truth", "stiffness [N m/rad]")
        bottom.set_xlabel("time [s]")
        _save(figure, path)


def _band(axes: Axes, band: Band, reference: str, label: str) -> None:
    """Estimate with its 95 % band where trusted, faint where the status says otherwise."""
    half = 1.96 * band.standard_deviation
    trusted = np.where(band.trusted, band.value, np.nan)
    axes.plot(band.time, band.value, color=FAINT, linewidth=0.9, label="held or warming up")
    axes.plot(band.time, trusted, color=MODEL, label="estimate, 95 % band")
    axes.fill_between(
        band.time, band.value - half, band.value + half, where=band.trusted, color=MODEL, alpha=0.2, linewidth=0
    )
    axes.plot(band.time, band.reference, color=REAL, linestyle="--", label=reference)
    seen = np.concatenate([band.reference, band.value[band.trusted]])
    seen = seen[np.isfinite(seen)]
    if seen.size:
        low, high = np.percentile(seen, [0.5, 99.5])
        room = 0.3 * max(high - low, 1e-9 + 0.1 * abs(high))
        axes.set_ylim(min(low - room, 0.0) if low - room < 0.3 * high else low - room, high + room)
    axes.set_ylabel(label)
    axes.legend(loc="upper right", ncols=3, fontsize=10)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
