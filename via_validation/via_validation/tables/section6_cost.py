"""Cost of Section 6's cycles: work of the motors compared with rigid joints, and processor time."""

from __future__ import annotations

from collections.abc import Callable

from via_validation.bench.controllers import limit_cycle_time
from via_validation.control.bang_bang import free_motion
from via_validation.control.energy import Energy, bang_bang_energy, limit_cycle_energy, scaled_energy
from via_validation.control.limit_cycle import limit_cycle_controller
from via_validation.tables.rows import Row

TOO_STIFF, SMALL = 3.0, 0.005  # factor on the matched K_d; H_d [kg m^2] at which no motor is at its limit
FREE, TURNS = 8.0, 5  # [s] duration of the bang-bang motion; repeats of the time measurement (median)
SETTINGS = (
    "positive work of the motors per cycle over that of computed torque on rigid joints with the same motors, on the "
    "same trajectory; reference_4dof"
)
RATIO = "work over rigid joints' [-]"


def rows(report: Callable[[str], None]) -> list[Row]:
    """Rows of numbers 9 and 10 of the specification."""
    report("energy")
    found = []
    for mode, limit in ((0, 0.25), (1, 0.25)):
        c, spent = limit_cycle_energy(mode)
        words = f"limit cycle on mode {mode + 1}, K_d matched to the springs, {c:.2f} diag(K_0)"
        found += _energy(f"6.energy.matched.mode{mode + 1}", words, spent, limit, "reference set-up but for K_d")
        words = f"limit cycle on mode {mode + 1}, K_d = diag(K_0): gravity and load make the arm stiffer"
        whole = scaled_energy(limit_cycle_controller(mode), 1.0)
        found += _energy(f"6.energy.as_set_up.mode{mode + 1}", words, whole, None, "reference set-up")
    c, spent = limit_cycle_energy(0, TOO_STIFF, SMALL)
    at, words = "6.energy.stiff.mode1", f"limit cycle on mode 1, K_d {TOO_STIFF:g} times too stiff, {c:.2f} diag(K_0)"
    found.append(Row(f"{at}.inverse", f"{words}: work of rigid joints over its work; it must not save energy",
                     "ratio [-]", None, 1.0 / spent.ratio, 1.0,
                     f"{SETTINGS}; H_d {SMALL:g}, at which no motor is at its limit", 0,
                     f"{spent.ratio:.2f} times the work of rigid joints; samples with a motor at its limit: "
                     f"{spent.saturated:.0%}"))  # fmt: skip
    motion = free_motion(1, FREE)
    found += _energy("6.energy.bang_bang", "bang-bang, mode 1", bang_bang_energy(motion), 0.45, "set-up of number 5")
    report("time of a step")
    found.append(Row("6.time.limit_cycle", "modal limit cycle on 4 flexible joints, one whole evaluation",
                     "time [us]", None, limit_cycle_time(TURNS), 250.0,
                     f"one core, called from Python, median of {TURNS} turns; via bench controllers"))  # fmt: skip
    return found


def _energy(at: str, words: str, spent: Energy, limit: float | None, setting: str) -> list[Row]:
    settings = f"{SETTINGS}; {setting}; {spent.cycles} cycles"
    return [
        Row(at, f"{words}: {spent.flexible:.3f} J per cycle", RATIO, None, spent.ratio, limit, settings),
        Row(f"{at}.links_only", f"{words}: compared with rigid joints with massless rotors", RATIO, None,
            spent.ratio_links_only, None, settings),
    ]  # fmt: skip
