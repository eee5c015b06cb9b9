"""Section 6.1: limit cycle on one mode of an arm, rigid and with flexible joints, held and released.

The document shows phase plots of the DLR Hand Arm System, which is not available, and prints no numbers. Our numbers
and limits are those of the specification's reference set-up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import FAINT, MODEL, STYLE, save_figure
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL, STIFFNESS
from via_controllers.arms.modal_limit_cycle_vsa import Swing, VsaModalLimitCycle
from via_controllers.arms.self_start import ENOUGH, START
from via_core.signals import Array
from via_core.springs import SinhSpring
from via_core.vsa_arms import VsaArm
from via_sim.robots.contacts import Hand

from via_validation.control.arm_run import PERIOD, ArmRun, Phase, TorqueNoise, run_arm
from via_validation.control.hold import Released, held_and_released
from via_validation.control.limit_cycle import (
    BANDWIDTH,
    GAIN,
    approach,
    cycling,
    in_modes,
    least_share,
    limit_cycle_controller,
    rigid,
)
from via_validation.tables.rows import Row
from via_validation.tables.section6_derivatives import derivative_rows

MODES = (0, 1)
NOISE, NOISY_RUNS = 0.05, 3  # [N m] of torque sensors; runs take long, and their largest leak counts
PHASES = 12  # phases of a hold, evenly around the cycle
ERRORS = ((1.0, 0.1), (1.5, 0.02))  # number 3: periods after the release, |H / H_d - 1| from then on
OFF = "|H / H_d - 1| [-]"
LEAK = "largest other mode over amplitude [-]"
SETTINGS = (
    "reference_4dof: q_d (.2, .4, .3, 1.2) rad, K_d (100, 100, 60, 60) N m/rad, xi .7, k_V 3, H_d .02; from half of "
    "the amplitude, at rest"
)
FLEXIBLE = (
    f"{SETTINGS}; springs K0/6 sinh(6 phi), controller at 1 kHz, omega_tau {BANDWIDTH:g} rad/s; second half of 3 s"
)
JOINTS = ("shoulder yaw", "shoulder pitch", "shoulder roll", "elbow")
COLOURS = ("#1b4965", "#d1495b", "#2a7f62", "#b08ea2")


def rows(seeds: int, report: Callable[[str], None]) -> list[Row]:
    """Rows of numbers 1 to 4 of the specification; noisy rows over at most `NOISY_RUNS` seeds."""
    found: list[Row] = []
    for what, part in (
        ("6.1 rigid", _rigid),
        ("6.1 flexible joints", _flexible),
        ("6.1 from rest", _from_rest),
        ("6.1 noise", lambda: _noisy(min(seeds, NOISY_RUNS))),
        ("6.1 derivatives", derivative_rows),
        ("6.1 held and released", _held),
    ):
        report(what)
        found += part()
    return found


def _rigid() -> list[Row]:
    found = []
    settings = f"{SETTINGS}, the others .03 off; rigid arm, control in continuous time (Runge-Kutta, 2 ms), last of 3 s"
    for mode in MODES:
        cycle = limit_cycle_controller(mode).cycle
        course = rigid(cycle, 3.0)
        late = len(course.H) * 2 // 3
        at, words = f"6.1.rigid.mode{mode + 1}", f"rigid arm, mode {mode + 1}"
        found += [
            Row(f"{at}.H", words, OFF, None, float(np.abs(course.H[late:]).max()), 1e-4, settings),
            Row(f"{at}.leak", words, LEAK, None, float(course.leak[late:].max()), 1e-6, settings),
        ]
    return found


def _flexible() -> list[Row]:
    found = []
    for mode in MODES:
        controller = limit_cycle_controller(mode)
        run = cycling(controller, 3.0)
        seen = in_modes(controller.cycle, run.q, run.velocity)
        outside = np.flatnonzero(np.abs(seen.H) > 0.02)
        frequency, linear = seen.frequencies()
        at, words = f"6.1.arm.mode{mode + 1}", f"flexible joints, mode {mode + 1}"
        found += [
            Row(f"{at}.H", words, OFF, None, float(np.abs(seen.H[seen.late]).max()), 2e-3, FLEXIBLE),
            Row(f"{at}.leak", words, LEAK, None, float(seen.leak[seen.late].max()), 1e-4, FLEXIBLE),
            Row(f"{at}.settling", f"{words}: within 2 % of H_d from", "time [s]", None,
                float((outside[-1] + 1) * PERIOD), 1.2, FLEXIBLE),
            Row(f"{at}.frequency", f"{words}: {frequency:.3f} Hz compared with sqrt(mean lambda) / 2 pi",
                "relative difference [-]", None, abs(frequency / linear - 1.0), 5e-3, FLEXIBLE),
            Row(f"{at}.saturated", f"{words}: samples with a motor at its limit", "share [-]", None,
                run.saturated, 0.0, FLEXIBLE),
        ]  # fmt: skip
    return found


def _noisy(seeds: int) -> list[Row]:
    found = []
    for mode in MODES:
        controller = limit_cycle_controller(mode)
        leaks = []
        for seed in range(seeds):
            run = cycling(controller, 3.0, noise=TorqueNoise(NOISE, seed))
            seen = in_modes(controller.cycle, run.q, run.velocity)
            leaks.append(float(seen.leak[seen.late].max()))
        found.append(Row(f"6.1.noise.mode{mode + 1}.leak", f"torque sensors with {NOISE:g} N m noise, mode {mode + 1}",
                         LEAK, None, max(leaks), 2e-3, FLEXIBLE, seeds, "the largest of all seeds"))  # fmt: skip
    return found


def _from_rest() -> list[Row]:
    """Rows of starts from rest at q_d, with springs loaded by gravity alone."""
    found = []
    settings = f"{FLEXIBLE.split('; from')[0]}; at rest at q_d, start {START:g}"
    for mode in MODES:
        controller = limit_cycle_controller(mode)
        run = cycling(controller, 1.5, share=0.0)
        seen = in_modes(controller.cycle, run.q, run.velocity)
        period = 2.0 * np.pi / np.sqrt(seen.eigenvalue[seen.late].mean())
        at, words = f"6.1.rest.mode{mode + 1}", f"from rest at z = 0, mode {mode + 1}"
        for periods, limit in ERRORS:
            error = float(np.abs(seen.H[round(periods * period / PERIOD) :]).max())
            found.append(Row(f"{at}.after{periods:g}", f"{words}: from {periods:g} T on", OFF, None, error, limit,
                             settings, 0, "same limits as after a release"))  # fmt: skip
        found += [
            Row(f"{at}.falls", f"{words}: largest decrease of H / H_d below {ENOUGH:g}", "H / H_d [-]", None,
                float(max(0.0, -np.diff(seen.H[seen.H < ENOUGH - 1.0]).min())), None, settings, 0,
                "V falls as H rises"),
            Row(f"{at}.saturated", f"{words}: samples with a motor at its limit", "share [-]", None,
                run.saturated, 0.0, settings),
        ]  # fmt: skip
    return found


@cache
def _releases_of(mode: int, start: float = START) -> tuple[Released, ...]:
    """The runs of one mode, computed once for rows and picture."""
    return tuple(held_and_released(mode, PHASES, start=start))


def _held() -> list[Row]:
    """Rows of number 3: our controller at every phase with limits, and the published one, which has no start."""
    found = []
    for mode in MODES:
        runs, printed = _releases_of(mode), _releases_of(mode, 0.0)
        at, words = f"6.1.hold.mode{mode + 1}", f"held 1 s and released, mode {mode + 1}"
        settings = (
            f"{FLEXIBLE.split('; from')[0]}; hand 5e3 N/m, 100 N s/m at the tip; {PHASES} phases evenly around the "
            f"cycle of {runs[0].period:.3f} s"
        )
        for periods, limit in ERRORS:
            errors = _errors(runs, periods)
            key, after = f"{at}.after{periods:g}", f"{words}: from {periods:g} T on"
            found += [
                Row(f"{key}.worst", f"{after}, worst of all phases", OFF, None, float(errors.max()), limit, settings),
                Row(f"{key}.median", f"{after}, median of all phases", OFF, None, float(np.median(errors)), None,
                    settings),
                Row(f"{key}.misses", f"{after}: phases that miss {limit:g}", "share [-]", None,
                    float(np.mean(errors > limit)), None, settings),
            ]  # fmt: skip
        found += [
            Row(f"{at}.leak", f"{words}: from 1 T on", LEAK, None, _leak(runs), None, settings),
            Row(f"{at}.force", f"{words}: on the hand, second half of the hold, published {_force(printed):.3g}",
                "largest force [N]", None, _force(runs), None, settings, 0,
                "the start pushes during the hold; motion of the links about the held tip adds to both"),
            *_held_printed(at, words, settings, printed),
        ]  # fmt: skip
    return found


def _held_printed(at: str, words: str, settings: str, runs: tuple[Released, ...]) -> list[Row]:
    """Rows of the published controller on the same holds, without limits."""
    needed = max(
        least_share(1.0 - limit, GAIN, LEVEL, runs[0].eigenvalue, periods * runs[0].period) for periods, limit in ERRORS
    )
    remark = (
        f"z = 0 is an equilibrium of it. (103) averaged: from h = H / H_d at release, 1/h - 1 decreases by "
        f"exp(-k_V lambda H_d t), which requires h > {needed:.3f} for both limits, |z| > {np.sqrt(needed):.2f} of the "
        f"amplitude; no force that is continuous in z and zd alone can keep them for every phase"
    )
    found = []
    for periods, limit in ERRORS:
        errors = _errors(runs, periods)
        found.append(
            Row(f"{at}.printed.after{periods:g}.worst", f"{words}: from {periods:g} T on, worst; (102) without a start",
                OFF, None, float(errors.max()), None, settings, 0,
                f"{np.sum(errors > limit)} of {len(runs)} phases beyond {limit:g}; {remark}")
        )  # fmt: skip
    return found


def _errors(runs: tuple[Released, ...], periods: float) -> Array:
    return np.array([run.error(periods) for run in runs])


def _leak(runs: tuple[Released, ...]) -> float:
    return max(float(run.course.leak[round(run.period / PERIOD) :].max()) for run in runs)


def _force(runs: tuple[Released, ...]) -> float:
    return max(run.force for run in runs)


def pictures(folder: Path, report: Callable[[str], None]) -> list[Path]:
    """Figure 16: phase plots of modes and joints; and H after a release, by phase."""
    report("Figure 16")
    drawn = [_figure16(folder / "figure16.png")]
    report("held and released")
    drawn.append(_releases(folder / "released.png"))
    return drawn


def _figure16(path: Path) -> Path:
    springs = [each for each in ARM.springs if isinstance(each, SinhSpring)]
    doubled = [SinhSpring(each.max_deflection, 2.0 * each.k, each.a) for each in springs]
    stiffer = replace(ARM, springs=tuple(doubled))
    cases: list[tuple[str, VsaModalLimitCycle, bool]] = [
        ("mode 1", limit_cycle_controller(0), False),
        ("mode 1, springs and K_d doubled", _on(stiffer, 2.0 * STIFFNESS, 0), False),
        ("mode 2", limit_cycle_controller(1), False),
        ("mode 1, held 1 s and released", limit_cycle_controller(0), True),
    ]
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 4, figsize=(16, 8), constrained_layout=True)
        for (title, controller, held), (modal, joints) in zip(cases, panels.T, strict=True):
            course, z, zd = _phase_plot(controller, held)
            for i, colour in enumerate(COLOURS):
                modal.plot(z[:, i], zd[:, i], color=colour, linewidth=0.9, label=f"mode {i + 1}")
                joints.plot(course.q[:, i] - EQUILIBRIUM[i], course.velocity[:, i], color=colour, linewidth=0.9,
                            label=JOINTS[i])  # fmt: skip
            modal.set_title(title, fontsize=13)
            modal.set_xlabel("z [sqrt(kg m^2) rad]")
            modal.set_ylabel("zd [sqrt(kg m^2) rad/s]")
            joints.set_xlabel("q - q_d [rad]")
            joints.set_ylabel("qd [rad/s]")
        for axes, where in zip(panels[:, 0], ("upper", "lower"), strict=True):
            figure.legend(*axes.get_legend_handles_labels(), loc=f"outside {where} center", ncols=4)
        return save_figure(figure, path)


def _on(arm: VsaArm, stiffness: Array, mode: int) -> VsaModalLimitCycle:
    """The reference controller for another arm."""
    controller = limit_cycle_controller(mode)
    return replace(controller, cycle=replace(controller.cycle, arm=arm, stiffness=stiffness))


def _phase_plot(controller: VsaModalLimitCycle, held: bool) -> tuple[ArmRun[Swing], Array, Array]:
    """A run from a tenth of the amplitude, or from the cycle with a hold; z and zd (N, n)."""
    arm = controller.cycle.arm
    if held:
        before = cycling(controller, 1.1, share=1.0)
        hand = Hand(arm.tip_position(before.body.q))
        phases = (Phase(1.0, (hand,), 4), Phase(3.0, substeps=4))
        run = run_arm(arm, controller, before.body, phases, before.state)
    else:
        run = cycling(controller, 4.0, share=0.1)
    z = np.stack([run.quantity(f"z_{mode + 1}") for mode in range(arm.n)], axis=1)
    return run, z, np.gradient(z, PERIOD, axis=0)


def _releases(path: Path) -> Path:
    """H after a release at all phases, with and without the start, and (103) averaged for the latter."""
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 2, figsize=(11, 8.2), sharex=True, sharey=True, constrained_layout=True)
        shades = plt.get_cmap("viridis")
        for (mode, start), axes in zip(product(MODES, (START, 0.0)), panels.T.flat, strict=True):
            runs = _releases_of(mode, start)
            for run in runs:
                time = np.arange(len(run.course.H)) * PERIOD / run.period
                axes.plot(time, run.course.H + 1.0, color=shades(abs(np.cos(run.phase))), linewidth=1.2)
            if not start:
                least = min(runs, key=lambda run: run.share)
                time = np.linspace(0.0, 4.0, 200)
                averaged = [approach(least.share, GAIN, LEVEL, least.eigenvalue, t * least.period) for t in time]
                axes.plot(time, averaged, color=MODEL, linestyle="--", label="(103) averaged, from the lowest")
                axes.legend(loc="lower right", fontsize=10)
            for periods, limit in ERRORS:
                axes.fill_between([periods, 4.0], 1.0 - limit, 1.0 + limit, color=FAINT, alpha=0.35, linewidth=0)
            axes.set_xlim(0.0, 3.0)
            axes.set_ylim(0.0, 1.2)
            words = "with start" if start else "(102) alone"
            axes.set_title(f"mode {mode + 1}, period {runs[0].period:.3f} s, {words}", fontsize=12)
        for axes in panels[1]:
            axes.set_xlabel("periods after the release [-]")
        for axes in panels[:, 0]:
            axes.set_ylabel("H / H_d [-]")
        bar = figure.colorbar(plt.cm.ScalarMappable(cmap=shades), ax=panels)
        bar.set_label("|cos| of the phase at the start of the hold [-]")
        return save_figure(figure, path)
