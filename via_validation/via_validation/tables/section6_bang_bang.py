"""Section 6.2: modal adaptive bang-bang control of the arm, free and against walls, and of the hopper.

The document shows the DLR Hand Arm System and a simulated biped, and prints no numbers. Our numbers and limits are
those of the specification's reference set-up.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE, STYLE, save_figure
from via_bringup.demo.reference import DIRECTIONS, MOTORS, TURNING, damped_arm, linear_modes

from via_validation.control.bang_bang import AMPLITUDE, degrees_between, free_motion
from via_validation.control.hitting import HELD, HOLDS, SUBSTEPS, WALLS, WEAK, Hitting, Impacts, hitting
from via_validation.control.hopper import AS_HIGH, PAYLOAD, Hopping, hop, reference_controller, sinusoid, toppling
from via_validation.control.nonlinear_mode import nonlinear_mode
from via_validation.tables.rows import Row

RATIO = (1.03, 1.15)  # required range of f over the frequency of the linear mode
FREE = 20.0  # [s]
SETTINGS = (
    "reference_4dof, theta_0 (.2, .5, .3, 1.3) rad, omega_m 60 rad/s, theta_hat .03 rad, eps .5 N m, zeta .05, gamma "
    ".05 per ms sample; controller at 1 kHz"
)
HOPPER = (
    "hopper of the specification in MuJoCo, a_0 .6 rad, 3 cm drop, omega_m 120 rad/s, theta_hat .1 rad, eps 1 N m, "
    "gamma .05 per ms sample, w_1(0) = sign(theta_0); second half of 12 s"
)
ANGLE = "angle [deg]"
BRAKE = "motors held, no friction, at rest at both ends; first principal component of its path"
CLOSE = (
    "modes 3 and 4 differ by 3 % in frequency, while friction makes resonances 10 % wide: the motors excite both. w_1 "
    "stays in their plane (.plane) and ends near the nonlinear mode into which hardening springs turn mode 4 at this "
    "swing (.bent, 6.2.close.mode3.long): no free motion of this swing is along linear mode 4. With smaller swings and "
    "a start on the mode, w_1 stays: 6.2.close"
)
NEAR = (3, 4)  # modes whose resonances overlap
LONG = 80.0  # [s]
JOINTS = ("shoulder yaw", "shoulder pitch", "shoulder roll", "elbow")
COLOURS = (REAL, MODEL, "#2a7f62", "#b08ea2")


def rows(report: Callable[[str], None]) -> list[Row]:
    """Rows of numbers 5, 6 and 7 of the specification."""
    found: list[Row] = []
    for mode in DIRECTIONS:
        report(f"6.2 free, mode {mode}")
        found += _free(mode)
    report("6.2 close modes")
    found += _close_modes()
    report("6.2 hitting")
    found += _hitting()
    report("6.2 hopper")
    return found + _hopping()


def _free(mode: int) -> list[Row]:
    motion = free_motion(mode, FREE)
    at, words = f"6.2.free.mode{mode}", f"free motion, w_1(0) = {DIRECTIONS[mode]}"
    settings = f"{SETTINGS}; released .1 rad along w_1(0), second half of {FREE:g} s"
    middle, half = 0.5 * sum(RATIO), 0.5 * (RATIO[1] - RATIO[0])
    free = nonlinear_mode(damped_arm(), np.array(MOTORS), mode, motion.swing)
    linear = linear_modes(damped_arm(), np.array(MOTORS)).directions
    like = f"nonlinear mode {mode} of this swing"
    found = [
        Row(f"{at}.angle", f"{words}: angle of w_1 to mode {mode} of (K + dg, M)", ANGLE, None, motion.angle, 3.0,
            settings, 0, CLOSE if motion.angle > 3.0 else ""),
        Row(f"{at}.period", f"{words}: period", "std / mean [-]", None, motion.period_sd, 1e-3, settings),
        Row(f"{at}.frequency", f"{words}: {motion.frequency:.3f} Hz, f / f_lin = {motion.ratio:.3f}",
            f"distance of f / f_lin from {middle:g} [-]", None, abs(motion.ratio - middle), half, settings),
        Row(f"{at}.swing", f"{words}: peak to peak of w_1' (q - q_0)", "swing [rad]", None, motion.swing, None,
            settings),
        Row(f"{at}.nonlinear", f"{words}: angle of w_1 to {like}", ANGLE, None,
            degrees_between(motion.direction, free.direction), None, f"{settings}; {BRAKE}"),
        Row(f"{at}.bent", f"angle of {like} to mode {mode} of (K + dg, M)", ANGLE, None,
            degrees_between(free.direction, linear[:, mode - 1]), None, BRAKE),
    ]  # fmt: skip
    if mode in NEAR:
        plane, _ = np.linalg.qr(linear[:, [near - 1 for near in NEAR]])
        inside = plane @ (plane.T @ motion.direction)
        found.append(
            Row(f"{at}.plane", f"{words}: angle of w_1 to the plane of modes {NEAR[0]} and {NEAR[1]}", ANGLE, None,
                degrees_between(motion.direction, inside), None, settings)
        )  # fmt: skip
    return found


def _close_modes() -> list[Row]:
    """Rows of modes 3 and 4: started on the mode with full and small swing, and after a long time."""
    found = []
    for mode in NEAR:
        for name, size in (("whole", 1.0), ("small", 1.0 / 3.0)):
            motion = free_motion(mode, FREE, True, size)
            words = f"free motion, w_1(0) = mode {mode}, f / f_lin = {motion.ratio:.3f}: angle of w_1 to it"
            settings = f"{SETTINGS}, theta_hat and eps times {size:.2g}; second half of {FREE:g} s"
            found.append(Row(f"6.2.close.mode{mode}.{name}", words, ANGLE, None, motion.angle, None, settings))
    first, last = NEAR
    end = free_motion(first, LONG)
    turned = nonlinear_mode(damped_arm(), np.array(MOTORS), last, end.swing)
    found.append(
        Row(f"6.2.close.mode{first}.long", f"free motion, w_1(0) = {DIRECTIONS[first]}, after {LONG:g} s: angle of "
            f"w_1 to nonlinear mode {last} of this swing", ANGLE, None,
            degrees_between(end.direction, turned.direction), None, f"{SETTINGS}; {BRAKE}")
    )  # fmt: skip
    return found


def hitting_rows(at: str, case: Impacts, settings: str) -> list[Row]:
    """Rows of number 6 for one case."""
    at = f"{at}.wall{case.wall:g}.hold{case.hold:g}"
    words = f"wall at {case.wall:g}, held at {case.hold:g} of the free turning point"
    slow = (
        f"within 5 % after {case.cycles_to_steady} cycles: the motors add energy at a limited rate, so that a release "
        "far below the steady amplitude needs more than one cycle"
    )
    settings = f"{settings}; wall 5e4 N/m, 300 N s/m; held {HELD:g} s, then 10 s, {SUBSTEPS} steps a ms"
    return [
        Row(f"{at}.second", f"{words}: peak to peak of the tip from the second full cycle on",
            "largest relative difference from steady [-]", None, case.second, 0.05, settings,
            0, slow if case.second > 0.05 else ""),
        Row(f"{at}.steady", f"{words}: steady peak to peak", "std / mean [-]", None, case.steady_sd, 5e-3,
            settings),
        Row(f"{at}.missed", f"{words}: steady cycles without contact; weakest impact {case.least_force:.0f} N",
            "cycles", None, float(case.least_force <= 0.0), 0.0, settings),
    ]  # fmt: skip


def _hitting() -> list[Row]:
    found = []
    for wall in WALLS:
        for hold in HOLDS:
            case = _case(wall, hold)
            found += hitting_rows("6.2.hitting", case, SETTINGS)
    return found + hitting_rows("6.2.hitting", _case(*WEAK), SETTINGS)


@cache
def _case(wall: float, hold: float) -> Hitting:
    return hitting(wall, hold)


@cache
def _hops() -> dict[str, Hopping]:
    """Runs of the controller and of the sinusoids, without and with the payload."""
    controller = reference_controller()
    free = hop(controller)
    first, high = sinusoid(free), sinusoid(free, AS_HIGH)
    return {
        "controller": free, "controller, loaded": hop(controller, PAYLOAD),
        "sinusoid": hop(first), "sinusoid, loaded": hop(first, PAYLOAD),
        "high sinusoid": hop(high), "high sinusoid, loaded": hop(high, PAYLOAD),
    }  # fmt: skip


def _hopping() -> list[Row]:
    hops = _hops()
    free, loaded = hops["controller"], hops["controller, loaded"]

    def kept(name: str) -> float:
        return hops[f"{name}, loaded"].amplitude / hops[name].amplitude

    load = f"payload of {PAYLOAD:.0%} of the trunk"
    amplitude = "trunk's peak to peak"
    return [
        Row("6.2.hopper.apex", f"apex above standing, mean {1e3 * free.apex:.1f} mm", "std / mean [-]", None,
            free.apex_sd, 1e-2, HOPPER),
        Row("6.2.hopper.ground", f"share of time on the ground: flight {free.flight:.3f}", "share [-]", None,
            1.0 - free.flight, 0.6, HOPPER),
        Row("6.2.hopper.frequency", "frequency found by the controller", "frequency [Hz]", None, free.frequency, None,
            HOPPER),
        Row("6.2.hopper.toppling", "growth of a pitch of .001 rad in a second", "factor [-]", None, toppling(), None,
            HOPPER, 0, f"the controller does not stabilise the pitch of the trunk; {load}: {toppling(PAYLOAD):.1f}. An "
            "additional controller is needed for it"),
        Row("6.2.hopper.payload", f"{load}: loss of the {amplitude}, {loaded.frequency:.2f} Hz", "loss [-]", None,
            1.0 - kept("controller"), 0.08, HOPPER),
        Row("6.2.hopper.payload.apex", f"{load}: apex", "std / mean [-]", None, loaded.apex_sd, None, HOPPER),
        Row("6.2.hopper.sinusoid", f"open-loop sinusoid at the controller's frequency, {load}: remaining {amplitude}",
            "share [-]", None, kept("sinusoid"), 0.85, f"{HOPPER}; amplitude: first harmonic of the switching",
            0, "limit: the loss must exceed 15 %"),
        Row("6.2.hopper.sinusoid.high", f"sinusoid as high as the controller, {load}: remaining {amplitude}",
            "share [-]", None, kept("high sinusoid"), None, f"{HOPPER}; amplitude {AS_HIGH:g} rad"),
    ]  # fmt: skip


def pictures(folder: Path, report: Callable[[str], None]) -> list[Path]:
    """Figures 17 and 18."""
    with plt.rc_context(STYLE):
        report("Figure 17")
        drawn = [_figure17(_case(0.5, 1.2), folder / "figure17.png")]
        report("Figure 18")
        return [*drawn, _figure18(folder / "figure18.png")]


def _figure17(case: Hitting, path: Path) -> Path:
    """Tip, motor references and contact force during the hold and four seconds after it."""
    run, shown = case.run, case.run.time < HELD + 4.0
    time = run.time[shown] - HELD
    figure, (tip, motors, force) = plt.subplots(3, 1, figsize=(9, 7.5), sharex=True, constrained_layout=True)
    for axis, name, colour in ((1, "y", REAL), (2, "z", MODEL)):
        tip.plot(time, 1e3 * (case.tip[shown, axis] - case.tip[shown, axis].mean()), color=colour, label=name)
    tip.set_ylabel("tip, about its mean [mm]")
    reference = AMPLITUDE * run.quantity("switch")[:, None] * run.values[:, 3:]
    for i, colour in enumerate(COLOURS):
        motors.plot(time, 1e3 * reference[shown, i], color=colour, linewidth=0.9, label=JOINTS[i])
    motors.set_ylim(-32.0, 42.0)
    motors.set_ylabel("theta_d - theta_0 [mrad]")
    force.plot(time, np.linalg.norm(run.force[shown], axis=1), color=REFERENCE, linewidth=0.9)
    force.set_ylabel("force on the tip [N]")
    force.set_xlabel("time after the release [s]")
    for axes in (tip, motors, force):
        axes.axvspan(-HELD, 0.0, color=FAINT, alpha=0.3, linewidth=0)
    tip.legend(loc="upper right", ncols=2)
    motors.legend(loc="upper right", ncols=4, fontsize=9)
    tip.set_title(f"wall at {case.wall:g} of the free turning point ({1e3 * TURNING:.0f} mrad)", fontsize=12)
    return save_figure(figure, path)


def _figure18(path: Path) -> Path:
    """Height of the trunk with the sinusoid and with the controller, without and with the payload."""
    hops = _hops()
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True, sharex=True, constrained_layout=True)
    for axes, name, title in zip(
        panels, ("sinusoid", "controller"), ("open-loop sinusoid", "modal adaptive bang-bang"), strict=True
    ):
        for key, colour, label in ((name, REAL, "no load"), (f"{name}, loaded", MODEL, f"{PAYLOAD:.0%} more trunk")):
            run = hops[key].run
            axes.plot(run.time, run.trunk[:, 1], color=colour, linewidth=0.9, label=label)
        axes.set_title(title, fontsize=12)
        axes.set_xlim(0.0, 6.0)
        axes.set_xlabel("time [s]")
    panels[0].set_ylabel("height of the trunk [m]")
    panels[0].legend(loc="lower right", ncols=2)
    return save_figure(figure, path)
