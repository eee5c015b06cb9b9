"""Pictures of Section 3: Figures 3 and 5."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import FAINT, MODEL, REAL, STYLE, save_figure
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_core.springs import ExponentialSpring
from via_core.status import Status
from via_estimators.contract import Estimates
from via_estimators.modulated_stiffness import ModulatedStiffness

from via_validation.tables.cubic_joint import POSITION_RATIO, TAU, THETA, TORQUE_RATIO, Log, cubic_log, log_of
from via_validation.tables.rows import Progress
from via_validation.tables.section3_methods import differentiated


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figure 3 (a, b, c) and Figure 5 (a, b)."""
    progress(0, 2, "Figure 3")
    paths = [_figure_3(folder / "figure_3.png")]
    progress(1, 2, "Figure 5")
    paths.append(_figure_5(folder / "figure_5.png"))
    progress(2, 2, "done")
    return paths


def _figure_3(path: Path) -> Path:
    log = cubic_log("E1")
    torque, position = log.noise_sd(TAU, TORQUE_RATIO), log.noise_sd(THETA, POSITION_RATIO)
    cases = (
        ("(a) noisy torques, clean positions, N = 2", 2, 0.0),
        ("(b) noisy torques and positions, N = 2", 2, position),
        ("(c) noisy torques and positions, N = 4", 4, position),
    )
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(3, 1, figsize=(9, 9.6), sharex=True, sharey=True, constrained_layout=True)
        for axes, (title, order, blur) in zip(panels, cases, strict=True):
            estimates = differentiated(order, log).run_rows(log.noisy(0, torque, blur))[1]
            axes.plot(log.rows[:, 0], _known(estimates), color=MODEL, label="estimate")
            axes.plot(log.rows[:, 0], log.stiffness, color=REAL, linestyle="--", label="truth")
            axes.set_title(title, fontsize=12)
            axes.set_ylabel("stiffness [N m/rad]")
        panels[0].legend(loc="upper right", ncols=2)
        panels[-1].set_xlabel("time [s]")
        panels[0].set_ylim(0.0, 1.4 * log.stiffness.max())
        return save_figure(figure, path)


def exponential_log() -> tuple[Device, Log]:
    """An antagonistic joint with exponential springs, and its log: slow motion for 20 s, deflections up to 1 rad."""
    t = np.arange(20_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    tones = np.stack([np.sin(2.0 * np.pi * 0.31 * middle), np.sin(2.0 * np.pi * 0.47 * middle + 1.0)], axis=1)
    motor = np.clip(t / 0.5, 0.0, 1.0)[:, None] * (2.5 + 1.5 * tones) * np.array([1.0, -1.0])
    device = load_device("dlr_bavs")
    smooth = tuple(each.model_copy(update={"coulomb_friction": 0.0}) for each in device.motors)
    ends = ((0.05, 0.25), (0.25, 0.05))
    springs = tuple(ExponentialSpring(1.5, k=1.0, rise=rise, fall=fall, a=3.0) for rise, fall in ends)
    device = device.model_copy(update={"motors": smooth, "springs": springs})
    return device, log_of(device, t, motor)


def _figure_5(path: Path) -> Path:
    """N = 9, T = .5 s, P(0) = 1e5 on exponential springs; the document's device and data are not available."""
    device, log = exponential_log()
    parameters = ModulatedStiffness.from_device(device).parameters
    estimator = ModulatedStiffness(replace(parameters, taylor_order=9, initial_covariance=1e5, torque_noise=0.02))
    estimates = estimator.run_rows(log.noisy(0, 0.02))[1]
    value = _known(estimates)
    with plt.rc_context(STYLE):
        figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 7), sharex=True, constrained_layout=True)
        top.plot(log.rows[:, 0], value, color=MODEL, label="estimate")
        top.plot(log.rows[:, 0], log.stiffness, color=REAL, linestyle="--", label="truth (simulated)")
        top.set_ylim(0.0, 1.3 * log.stiffness.max())
        top.set_ylabel("total device stiffness [N m/rad]")
        top.legend(loc="upper right", ncols=2)
        top.set_title("exponential springs in simulation, N = 9; the document's device is not available", fontsize=12)
        bottom.plot(log.rows[:, 0], 100.0 * np.abs(value / log.stiffness - 1.0), color=MODEL)
        bottom.axhline(25.0, color=FAINT, linestyle="--")
        bottom.set_ylim(0.0, 60.0)
        bottom.set_ylabel("relative error [%]")
        bottom.set_xlabel("time [s]")
        return save_figure(figure, path)


def _known(estimates: Estimates) -> Array:
    """Device stiffness (n,), NaN during warm-up."""
    return np.where(estimates.status == Status.WARMING_UP, np.nan, estimates.column("stiffness")[0])
