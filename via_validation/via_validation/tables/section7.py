"""Section 7: maximum link velocity of a visco-elastic joint. Closed forms, their checks, and loss with real motors.

The document prints pictures but no numbers; the limits are those of the specification. The checks are independent of
the closed form: quadrature of |g|, a linear program over exact steps, and collocation with IPOPT.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import quad
from via_bringup.demo.pictures import FAINT, MODEL, REAL, REFERENCE, STYLE, save_figure
from via_bringup.demo.reference import throwing_controller
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_core.devices import load_device
from via_core.signals import Array
from via_sim.sensors import Sensors

from via_validation.control.throw import throw
from via_validation.switching import collocation, program
from via_validation.switching.motor_models import DrivenJoint, Optimum
from via_validation.switching.performance import bound, performance, velocity_with
from via_validation.tables.rows import Progress, Row

OMEGA = 3.0  # [rad/s]
DAMPING = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5)
TURNS = (0, 1, 2, 4)
SWINGS = 1.3  # of the motor after its first turn, in the horizon of the checks
RATIO = "link over motor velocity [-]"
OFF = "relative difference [-]"
# Values in the specification: (turns, None for infinitely many; D; value; half of its last digit)
PRINTED = (
    (None, 0.1, 6.49638, 5e-6),
    (None, 0.4, 1.97438, 5e-6),
    (2, 0.1, 3.969098, 5e-7),
    (4, 0.4, 1.971841, 5e-7),
)
CONTROL_LIMITS = {"quadrature": 1e-9, "program": 1e-6, "collocation": 3e-4}
# Motors to compare with the ideal one, at D = .3; largest velocity 1 rad/s.
REAL_D = 0.3
MOTORS = (
    DrivenJoint(ViscoElasticJoint(OMEGA, REAL_D), "velocity", 1.0),
    DrivenJoint(ViscoElasticJoint(OMEGA, REAL_D), "acceleration", 20.0, 1.0),
    DrivenJoint(ViscoElasticJoint(OMEGA, REAL_D), "torque", 20.0, 1.0, motor_inertia=0.5),
)
UNITS = {"velocity": "rad/s", "acceleration": "rad/s^2", "torque": "N m"}
STEPS = 800  # of the linear program for non-ideal motors
DEVICE = "visco_elastic_demo"


def horizon(joint: ViscoElasticJoint, swings: float = SWINGS) -> float:
    """t_f [s] for `swings` swings after the first turn; without a second turn, a swing counts as 2 s."""
    return joint.first_turn + swings * min(joint.between_turns, 2.0)


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Rows of epsilon(n, D), its checks, and three motors; `seeds` is unused: rows have a fixed seed or none."""
    parts = (
        ("eps(n, D)", _table),
        ("checks", _checks),
        ("uniform turns", _uniform),
        ("motors", _motors),
        ("simulated joint", _simulated),
    )
    found: list[Row] = []
    for number, (what, part) in enumerate(parts):
        progress(number, len(parts), what)
        found += part()
    progress(1, 1, "done")
    return found


def _table() -> list[Row]:
    settings = "closed form; t_f = (2 arccos D + n pi) / omega_d; one turn at most for critical damping and above"
    found = []
    for D in DAMPING:
        values = {f"n{n}": (f"n = {n} turns", performance(n, D)) for n in (TURNS if D < 1.0 else TURNS[:1])}
        if D > 0.0:  # without damping 2 (n + 1) is unbounded
            values["inf"] = ("unlimited time", bound(D))
        found += [Row(f"7.epsilon.{name}.D{D:g}", f"{what}, D = {D:g}", RATIO, None, value, None, settings)
                  for name, (what, value) in values.items()]  # fmt: skip
    return found


def _checks() -> list[Row]:
    found = []
    for turns, D, value, half in PRINTED:
        ours = bound(D) if turns is None else performance(turns, D)
        name = "inf" if turns is None else f"n{turns}"
        found.append(Row(f"7.check.{name}.D{D:g}", f"eps({'inf' if turns is None else turns}, {D:g}) = {value} of the "
                         "specification", "difference [-]", None, abs(ours - value), half,
                         "closed form; limit: half of the last printed digit"))  # fmt: skip
    for D in DAMPING:
        joint = ViscoElasticJoint(OMEGA, D)
        t_f = horizon(joint)
        ideal = joint.fastest(t_f)
        others = {
            "quadrature": (_by_quadrature(joint, t_f), "integral of |g| between its zeros, adaptive quadrature"),
            "program": (
                program.largest_velocity(DrivenJoint(joint, "velocity", 1.0), t_f, steps=40).velocity,
                "linear program (HiGHS), 40 exact steps, halved near switches down to 1e-4 t_f",
            ),
            "collocation": (
                collocation.largest_velocity(DrivenJoint(joint, "velocity", 1.0), t_f).velocity,
                "collocation (CasADi, IPOPT), 200 intervals, Radau of degree 3; no switch within an interval",
            ),
        }
        for name, (value, how) in others.items():
            found.append(Row(f"7.{name}.D{D:g}", f"closed form compared with {name}, D = {D:g}", OFF, None,
                             abs(value / ideal - 1.0), CONTROL_LIMITS[name],
                             f"{how}; omega {OMEGA:g} rad/s, {SWINGS} swings after the first turn"))  # fmt: skip
    return found


def _by_quadrature(joint: ViscoElasticJoint, t_f: float) -> float:
    ends = [0.0, *(t_f - joint.turns(t_f))[::-1], t_f]
    return sum(
        abs(quad(lambda t: float(joint.response(np.asarray(t))), a, b, epsabs=1e-13, epsrel=1e-13)[0])
        for a, b in pairwise(ends)
    )


def _uniform() -> list[Row]:
    """Rows of the loss if the control is periodic with omega_d in the last interval too, as printed."""
    found = []
    for D, limit in ((0.1, None), (0.2, None), (0.4, 0.9)):
        joint = ViscoElasticJoint(OMEGA, D)
        t_f = horizon(joint, 4.0)
        uniform = t_f - joint.between_turns * np.arange(1.0, 5.0)
        found.append(Row(f"7.uniform.D{D:g}", f"turns every pi / omega_d up to the end (printed), D = {D:g}",
                         "share of the fastest [-]", None, velocity_with(joint, uniform, t_f) / joint.fastest(t_f),
                         limit, "closed form, t_f = t_4; limit: the loss must exceed a tenth",
                         0, "the last interval is 2 arccos(D) / omega_d"))  # fmt: skip
    return found


def _motors() -> list[Row]:
    found = []
    for driven in MOTORS[1:]:
        t_f = horizon(driven.joint)
        optimum = _optimum(driven)
        second = collocation.largest_velocity(driven, t_f, intervals=400)
        at = f"7.motor.{driven.drive}"
        settings = (
            f"omega {OMEGA:g} rad/s, D {REAL_D:g}, |u| <= {driven.limit:g} {UNITS[driven.drive]}, |thetad| <= 1 rad/s, "
            f"M 1, B {driven.motor_inertia:g} kg m^2; program of {STEPS} steps, halved near switches, collocation of "
            "400 intervals"
        )
        found += [
            Row(f"{at}.methods", f"{driven.drive} drive: collocation compared with linear program", OFF, None,
                abs(second.velocity / optimum.velocity - 1.0), CONTROL_LIMITS["collocation"], settings),
            Row(f"{at}.integral", f"{driven.drive} drive: (125) from its motor velocity", OFF, None,
                abs(_by_125(driven.joint, optimum, t_f) / optimum.velocity - 1.0), 1e-4, settings),
            Row(f"{at}.share", f"{driven.drive} drive: velocity over that with the ideal motor",
                "share of the fastest [-]", None, optimum.velocity / driven.joint.fastest(t_f), 1.0, settings),
        ]  # fmt: skip
    return found


def _optimum(driven: DrivenJoint) -> Optimum:
    return program.largest_velocity(driven, horizon(driven.joint), STEPS, finest=1e-3)


def _by_125(joint: ViscoElasticJoint, found: Optimum, t_f: float) -> float:
    fine = np.linspace(0.0, t_f, 200_001)
    motor = np.interp(fine, found.time, found.motor_velocity)
    return float(np.trapezoid(joint.response(t_f - fine) * motor, fine))


def _simulated() -> list[Row]:
    device, found = load_device(DEVICE), []
    for command, turns in ((0.0, 0), (0.0, 3), (1.0, 1)):
        controller, ideal = throwing_controller(device, command, turns)
        reached = throw(device, controller, command, Sensors.of_device(device)).velocity[-1]
        D = controller.damping / (2.0 * np.sqrt(device.link.inertia * float(controller.spring.stiffness(0.0))))
        what = f"maximum-velocity controller on the simulated joint, n = {turns}, D = {D:g}"
        found.append(Row(f"7.joint.n{turns}.D{D:g}", what, OFF, None, abs(reached / ideal - 1.0), 5e-3,
                         f"{DEVICE}: torque motor, encoder steps, controller at 1 kHz", 1))  # fmt: skip
    return found


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figure 20: epsilon over D. Figure 21: the fastest motions with three motors."""
    with plt.rc_context(STYLE):
        progress(0, 2, "Figure 20")
        drawn = [_figure20(folder / "figure20.png")]
        progress(1, 2, "Figure 21")
        drawn.append(_figure21([_optimum(driven) for driven in MOTORS], folder / "figure21.png"))
    progress(2, 2, "done")
    return drawn


def _figure20(path: Path) -> Path:
    D = np.concatenate([np.linspace(0.0, 0.99, 199), np.linspace(1.0, 2.0, 51)])
    figure, axes = plt.subplots(figsize=(9, 5), constrained_layout=True)
    shades = plt.get_cmap("viridis")(np.linspace(0.85, 0.1, len(TURNS) + 2))
    for n, shade in zip((*TURNS, 8), shades, strict=False):
        axes.plot(D, [performance(n, value) for value in D], color=shade, label=f"n = {n}")
    axes.plot(D[1:], [bound(value) for value in D[1:]], color=MODEL, linestyle="--", label="unlimited time")
    axes.axvline(1.0, color=FAINT, linewidth=0.8)
    axes.annotate("critical:\none turn at most", (1.02, 6.0), color=REFERENCE, fontsize=10)
    axes.set_ylim(1.0, 12.0)
    axes.set_xlim(0.0, 2.0)
    axes.set_xlabel("damping ratio D [-]")
    axes.set_ylabel("link over motor velocity, eps(n, D) [-]")
    axes.legend(loc="upper right")
    return save_figure(figure, path)


def _figure21(found: Sequence[Optimum], path: Path) -> Path:
    """Control, motor and link velocity over time, and the switching function of (125); one column per motor."""
    figure, panels = plt.subplots(3, 3, figsize=(11, 7.5), sharex=True, constrained_layout=True)
    for driven, optimum, column in zip(MOTORS, found, panels.T, strict=True):
        t_f = horizon(driven.joint)
        fine = np.linspace(0.0, t_f, 500)
        column[0].set_title(f"{driven.drive} as input, {optimum.velocity:.3f} rad/s", fontsize=12)
        column[0].step(optimum.time, np.append(optimum.control, optimum.control[-1]), where="post", color=REAL)
        column[0].set_ylabel(f"input [{UNITS[driven.drive]}]")
        motor = optimum.motor_velocity
        drawstyle = "steps-post" if driven.drive == "velocity" else "default"
        column[1].plot(optimum.time, motor, color=MODEL, label="motor", drawstyle=drawstyle)
        column[1].plot(optimum.time, optimum.state[:, 1], color=REAL, label="link")
        column[1].set_ylabel("velocity [rad/s]")
        column[1].set_ylim(-2.2, 2.6)
        sigma = -driven.joint.response(t_f - fine)
        column[2].plot(fine, sigma, color=REFERENCE)
        column[2].fill_between(fine, 0.0, sigma, where=_signs(sigma), color=FAINT, alpha=0.4, linewidth=0)
        column[2].set_ylabel("sigma* of (125) [1/s]")
        column[2].set_xlabel("time [s]")
    panels[1, 0].legend(loc="upper left", ncols=2, fontsize=10)
    return save_figure(figure, path)


def _signs(values: Array) -> list[bool]:
    return [bool(value < 0.0) for value in values]
