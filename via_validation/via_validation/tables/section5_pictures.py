"""Pictures of Section 5: Figures 9 to 14 with the document's axes, from one run of each experiment with friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE, STYLE, save_figure
from via_core.metrics import WIDTH_95
from via_core.signals import Array
from via_estimators.contract import rows_of
from via_sim.simulate import Simulation

from via_validation.tables.rows import Progress
from via_validation.tables.section5_methods import PERCENT, directional, trend
from via_validation.tables.vpda import EXPERIMENTS, Experiment


@dataclass(frozen=True)
class Run:
    """One run with n = 2, as in the document's figures; all signals at the stamp of their window's end.

    w (N, 2) [N m s/rad], damping and its sd (N,) [N m s/rad], measured and estimated torque (N,) [N m]
    """

    run: Simulation
    w: Array
    damping: Array
    sd: Array
    measured: Array
    estimated: Array


def run_of(experiment: Experiment) -> Run:
    """Seed 0 of an experiment, estimated step by step."""
    run, estimator = experiment.run(0), directional(2, dry_friction=0.0)
    rows_in = rows_of(run.measured, estimator.inputs)
    state, w = estimator.init(), np.empty((len(rows_in), 2))  # without friction as a third unknown
    damping, sd = np.empty(len(rows_in)), np.empty(len(rows_in))
    for k, row in enumerate(rows_in):
        state, estimate = estimator.step(state, row)
        w[k], damping[k], sd[k] = (
            estimator.coefficients(state)[:2],
            estimate.value[0],
            estimate.standard_deviation[0],
        )
    earlier = np.maximum(np.arange(len(rows_in)) - estimator.parameters.window // 2, 0)
    velocity = run.truth["q_velocity"][earlier]
    estimated = w[:, 0] * velocity + w[:, 1] * velocity * (velocity / estimator.parameters.velocity_scale) ** 2
    return Run(run, w, damping, sd, run.measured["tau_link"][earlier], estimated)


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Draw Figures 9 to 14."""
    progress(0, 3, "Figures 9 to 12")
    constant = run_of(EXPERIMENTS[2])
    progress(1, 3, "Figures 13 and 14")
    varying = run_of(EXPERIMENTS[3])
    with plt.rc_context(STYLE):
        drawn = [
            _torque_over_velocity(constant.run, folder / "figure9.png"),
            _panels((_clutch, _velocity), constant, folder / "figure10.png"),
            _panels((_torque, _torque_error), constant, folder / "figure11.png"),
            _panels((_coefficients, _damping, _damping_error), constant, folder / "figure12.png"),
            _panels((_clutch, _torque, _torque_error), varying, folder / "figure13.png"),
            _panels((_coefficients, _damping, _damping_error), varying, folder / "figure14.png"),
        ]
    progress(3, 3, "done")
    return drawn


def _panels(draw: Sequence[Callable[[Axes, Run], None]], seen: Run, path: Path) -> Path:
    """Panels over time, one below the other."""
    size = (9, 1.0 + 2.4 * len(draw))
    figure, axes = plt.subplots(len(draw), 1, figsize=size, sharex=True, constrained_layout=True)
    for one, panel in zip(axes, draw, strict=True):
        panel(one, seen)
        if one.get_legend_handles_labels()[0]:
            one.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=10, borderaxespad=0.2)
    axes[-1].set_xlabel("time [s]")
    return save_figure(figure, path)


def _torque_over_velocity(run: Simulation, path: Path) -> Path:
    slope, _ = trend(run)
    velocity = run.truth["q_velocity"]
    ends = np.array([velocity.min(), velocity.max()])
    figure, axes = plt.subplots(figsize=(9, 4.5), constrained_layout=True)
    axes.plot(velocity, run.measured["tau_link"], ".", color=REAL, markersize=1.5, label="measured")
    axes.plot(ends, slope * ends, color=MODEL, label=f"trend line, D = {slope:.2f} N m s/rad")
    axes.set_xlabel("relative velocity [rad/s]")
    axes.set_ylabel("dissipation torque [N m]")
    axes.legend(loc="upper left", markerscale=6.0)
    return save_figure(figure, path)


def _clutch(axes: Axes, seen: Run) -> None:
    """Commanded damping, in place of the normal force, which the simulated clutch does not have."""
    axes.plot(seen.run.truth.time[1:], seen.run.truth["damping"][1:], color=REAL)
    axes.set_ylabel("clutch, commanded\n[N m s/rad]")


def _velocity(axes: Axes, seen: Run) -> None:
    axes.plot(seen.run.truth.time, seen.run.truth["q_velocity"], color=REAL)
    axes.set_ylabel("relative velocity\n[rad/s]")


def _torque(axes: Axes, seen: Run) -> None:
    axes.plot(seen.run.measured.time, seen.measured, color=REAL, label="measured")
    axes.plot(seen.run.measured.time, seen.estimated, color=MODEL, linestyle="--", label="estimated")
    axes.set_ylabel("dissipation\ntorque [N m]")


def _torque_error(axes: Axes, seen: Run) -> None:
    error = PERCENT * (seen.measured - seen.estimated) / np.ptp(seen.measured)
    axes.plot(seen.run.measured.time, error, color=REAL, linewidth=0.8)
    axes.set_ylabel("normalised\nerror [%]")
    axes.set_ylim(-5.0, 5.0)


def _coefficients(axes: Axes, seen: Run) -> None:
    axes.plot(seen.run.measured.time, seen.w[:, 0], color=REAL, label="w_1")
    axes.plot(seen.run.measured.time, seen.w[:, 1], color=MODEL, linestyle="--", label="w_2")
    axes.set_ylabel("coefficients\n[N m s/rad]")


def _damping(axes: Axes, seen: Run) -> None:
    time, half = seen.run.measured.time, WIDTH_95 * seen.sd
    low, high = seen.damping - half, seen.damping + half
    axes.fill_between(time, low, high, color=FAINT, alpha=0.6, linewidth=0, label="95 % band")
    axes.plot(time[1:], seen.run.truth["damping"][1:], color=REAL, label="commanded")
    axes.plot(time, seen.damping, color=MODEL, linestyle="--", label="estimated")
    axes.set_ylabel("damping\n[N m s/rad]")
    axes.set_ylim(0.0, 5.0)


def _damping_error(axes: Axes, seen: Run) -> None:
    truth = seen.run.truth["damping"]
    axes.plot(seen.run.measured.time[1:], PERCENT * (seen.damping[1:] / truth[1:] - 1.0), color=REFERENCE)
    axes.set_ylabel("error [%]")
    axes.set_ylim(-40.0, 40.0)
