"""Controllers of arms under model errors: the published modal limit cycle, the adaptive one, and bang-bang control.

The document has no such table. Every case changes one thing that the controllers' model does not contain, the last two
several; the plant is `via_validation.control.model_error`. The adaptive controller gets the estimates of `payload` and,
joint by joint, of the default stiffness estimator, as over DDS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from via_bringup.demo.pictures import FAINT, STYLE, save_figure
from via_bringup.demo.reference import ARM, DIRECTIONS, MOTORS, damped_arm, linear_modes
from via_controllers.arm_methods import ModalLimitCycleParameters
from via_core.signals import Array

from via_validation.control.bang_bang import degrees_between, pushed, reference_controller
from via_validation.control.cycles import Cycles
from via_validation.control.limit_cycle import CycleCourse, in_modes, limit_cycle_controller, start
from via_validation.control.model_error import ErrorRun, Estimators, ModelError, run_with_error
from via_validation.tables.rows import Progress, Row

FOREARM = 2.2  # [kg] mass of reference_4dof's forearm
MODES = (0, 1)
DURATION, FROM = 6.0, 5.0  # [s] of a run, and from where on it is evaluated
BANG_BANG, STEADY = 14.0, 8.0  # [s] likewise
H_LIMIT, LEAK_LIMIT, NOMINAL_H = 0.02, 0.005, 2e-3
ANGLE, RATIO = 3.0, (1.07, 1.09)  # [deg] of w_1 from a mode; f / f_lin, of bang-bang control
OFF, LEAK = "|H / H_d - 1| [-]", "largest other mode over amplitude [-]"


@dataclass(frozen=True)
class Case:
    """One model error; `limited`: whether the adaptive controller has to keep the limits."""

    key: str
    what: str
    error: ModelError
    limited: bool = False


CASES = (
    Case("nominal", "no error", ModelError(), True),
    *(
        Case(f"payload{share}", f"payload {share} % of the forearm's mass", ModelError(payload=share * FOREARM / 100.0),
             True)
        for share in (10, 20, 30, 50)
    ),
    *(
        Case(f"springs{percent:+d}", f"springs {percent:+d} %", ModelError(spring_scale=1.0 + percent / 100.0), True)
        for percent in (-20, -10, 10, 20)
    ),
    Case("link_friction", "viscous friction of links .5 N m s/rad", ModelError(link_friction=0.5), True),
    Case("dry_friction", "dry friction of motors .5 N m", ModelError(dry_friction=0.5), True),
    Case("delay2", "torques 2 ms late", ModelError(delay=2e-3), True),
    Case("delay5", "torques 5 ms late", ModelError(delay=5e-3)),
    Case("delay5_stated", "torques 5 ms late, as stated in `delay`", ModelError(delay=5e-3, stated_delay=5e-3), True),
    Case("rate500", "500 Hz", ModelError(rate=500.0), True),
    Case("rate250", "250 Hz", ModelError(rate=250.0), True),
    Case("rate500_delay2", "500 Hz and 2 ms late", ModelError(rate=500.0, delay=2e-3), True),
    Case("encoders17", "encoders of 17 bit", ModelError(encoder=2.0 * np.pi / 2**17), True),
    Case("encoders14", "encoders of 14 bit", ModelError(encoder=2.0 * np.pi / 2**14), True),
    Case("several", "payload 20 %, springs -10 %, 500 Hz and 2 ms late",
         ModelError(payload=0.2 * FOREARM, spring_scale=0.9, rate=500.0, delay=2e-3), True),
    Case("many", "payload 20 %, springs -10 %, both frictions, 500 Hz and 5 ms late, as stated in `delay`",
         ModelError(0.2 * FOREARM, 0.9, 0.5, 0.5, 5e-3, 500.0, stated_delay=5e-3), True),
)  # fmt: skip
BY_KEY = {case.key: case for case in CASES}
SETTINGS = (
    f"reference_4dof as in 6.1, from half of the amplitude; largest value from {FROM:g} s to {DURATION:g} s; adaptive: "
    "modal_limit_cycle with adapt, payload and stiffness estimators with default parameters; modes and states of the "
    "real arm"
)
BANG_SETTINGS = f"set-up of 6.2 with link friction; from {STEADY:g} s to {BANG_BANG:g} s; modes of the real arm"


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Two rows per case and mode for limit cycles, two for bang-bang control."""
    found: list[Row] = []
    for number, case in enumerate(CASES):
        progress(number, len(CASES), case.what)
        for mode in MODES:
            found += _cycle_rows(case, mode)
    for number, case in enumerate(CASES):
        progress(number, len(CASES), f"bang-bang, {case.what}")
        for mode in MODES:
            found += _bang_bang_rows(case, mode)
    progress(1, 1, "done")
    return found


@cache
def cycle_run(key: str, mode: int, adapt: bool) -> tuple[ErrorRun, CycleCourse]:
    """The limit cycle under the error of this case, k = `mode`, and its course in the modes of the real arm."""
    published = limit_cycle_controller(mode)
    parameters = ModalLimitCycleParameters(mode=mode + 1, adapt=adapt)
    controller, estimators = (parameters.adaptive(), Estimators(ARM, ARM.name)) if adapt else (published, None)
    error = BY_KEY[key].error
    run = run_with_error(ARM, controller, start(published), error, DURATION, estimators)
    return run, in_modes(replace(published.cycle, arm=error.plant(ARM)), run.q, run.velocity)


def _cycle_rows(case: Case, mode: int) -> list[Row]:
    largest = {}
    for adapt in (False, True):
        run, course = cycle_run(case.key, mode, adapt)
        late = run.time >= FROM
        largest[adapt] = [float(np.abs(each[late]).max()) if run.finished else np.nan
                         for each in (course.H, course.leak)]  # fmt: skip
    at, words = f"6.errors.{case.key}.mode{mode + 1}", f"{case.what}, mode {mode + 1}"
    limits = (NOMINAL_H if case.key == "nominal" else H_LIMIT, LEAK_LIMIT) if case.limited else (None, None)
    names = (("H", OFF), ("leak", LEAK))
    return [
        Row(f"{at}.{name}", f"{words}; published controller {printed:.3g}", quantity, None, ours, limit, SETTINGS)
        for (name, quantity), printed, ours, limit in zip(names, largest[False], largest[True], limits, strict=True)
    ]


def _bang_bang_rows(case: Case, mode: int) -> list[Row]:
    model = damped_arm()
    controller = reference_controller(model, np.array(DIRECTIONS[mode + 1]))
    run = run_with_error(model, controller, pushed(controller), case.error, BANG_BANG)
    linear = linear_modes(case.error.plant(model), np.array(MOTORS))
    late = run.time >= STEADY
    w, y = run.values[-1, 3:], run.quantity("y")[late]
    cycles = Cycles(run.time[late], y, float(0.5 * (y.max() + y.min())))
    angle = degrees_between(w, linear.directions[:, mode]) if run.finished else np.nan
    ratio = 1.0 / (float(cycles.periods.mean()) * linear.frequencies[mode]) if len(cycles.periods) else np.nan
    at, words = f"6.errors.bang_bang.{case.key}.mode{mode + 1}", f"bang-bang, {case.what}, mode {mode + 1}"
    middle = 0.5 * sum(RATIO)
    return [
        Row(f"{at}.angle", f"{words}: w_1 from the mode", "angle [deg]", None, angle, ANGLE, BANG_SETTINGS),
        Row(f"{at}.frequency", f"{words}: f / f_lin = {ratio:.3f}", f"distance of f / f_lin from {middle:g} [-]", None,
            abs(ratio - middle), None, BANG_SETTINGS),
    ]  # fmt: skip


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """H and leak over time for a payload and for soft springs, published and adaptive, and the corrected model."""
    progress(0, 1, "picture")
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(3, 2, figsize=(11, 9), sharex=True, constrained_layout=True)
        shown = (
            ("payload20", "payload", "payload [kg]"),
            ("springs-10", "spring_scale_4", "scale of the elbow spring [-]"),
        )
        for (key, name, unit), column in zip(shown, panels.T, strict=True):
            _panel(key, name, unit, column)
        drawn = save_figure(figure, folder / "adaptation.png")
    progress(1, 1, "done")
    return [drawn]


def _panel(key: str, name: str, unit: str, column: Array) -> None:
    upper, middle, lower = column
    for adapt, colour, words in ((False, FAINT, "published"), (True, "#d1495b", "adaptive")):
        run, course = cycle_run(key, 0, adapt)
        upper.plot(run.time, course.H + 1.0, color=colour, label=words)
        middle.semilogy(run.time, np.maximum(course.leak, 1e-6), color=colour, label=words)
        if adapt:
            lower.plot(run.time, run.quantity(name), color=colour)
    upper.set_title(f"mode 1, {BY_KEY[key].what}", fontsize=12)
    upper.axhspan(1.0 - H_LIMIT, 1.0 + H_LIMIT, color=FAINT, alpha=0.35, linewidth=0)
    upper.set_ylabel("H / H_d [-]")
    middle.axhline(LEAK_LIMIT, color=FAINT, linestyle="--")
    middle.set_ylabel("other modes / amplitude [-]")
    lower.set_ylabel(unit)
    lower.set_xlabel("time [s]")
    upper.legend(loc="lower right", fontsize=10)
