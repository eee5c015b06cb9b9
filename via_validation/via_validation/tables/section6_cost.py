"""What Section 6's cycles cost: work of the motors beside rigid joints, and time of the processor."""

from __future__ import annotations

from collections.abc import Callable

from via_validation.bench.controllers import limit_cycle_time
from via_validation.control.bang_bang import free_motion
from via_validation.control.energy import Energy, bang_bang_energy, limit_cycle_energy, scaled_energy
from via_validation.control.limit_cycle import law_of
from via_validation.tables.rows import Row

TOO_STIFF, SMALL = 3.0, 0.005  # of the matched K_d; H_d [kg m^2] at which motors are not yet at their limits
FREE, TURNS = 8.0, 5  # [s] of the bang-bang law's motion; repeats of a time, of which the median counts
SETTINGS = (
    "positive work of the motors per cycle over that of computed torque on rigid joints with the same motors, on the "
    "same trajectory; reference_4dof"
)
RATIO = "work over rigid joints' [-]"


def rows(told: Callable[[str], None]) -> list[Row]:
    """Numbers 9 and 10."""
    told("energy")
    found = []
    for mode, limit in ((0, 0.25), (1, 0.25)):
        c, spent = limit_cycle_energy(mode)
        words = f"limit cycle on mode {mode + 1}, K_d matched to the springs, {c:.2f} diag(K_0)"
        found += _energy(f"6.energy.matched.mode{mode + 1}", words, spent, limit, "reference set-up but for K_d")
        words = f"limit cycle on mode {mode + 1}, K_d = diag(K_0): gravity and load make the arm stiffer"
        whole = scaled_energy(law_of(mode), 1.0)
        found += _energy(f"6.energy.as_set_up.mode{mode + 1}", words, whole, None, "reference set-up")
    c, spent = limit_cycle_energy(0, TOO_STIFF, SMALL)
    at, words = "6.energy.stiff.mode1", f"limit cycle on mode 1, K_d {TOO_STIFF:g} times too stiff, {c:.2f} diag(K_0)"
    found.append(Row(f"{at}.inverse", f"{words}: rigid joints' work over it; it must not save any", "ratio [-]", None,
                     1.0 / spent.ratio, 1.0, f"{SETTINGS}; H_d {SMALL:g}, at which no motor is at its limit", 0,
                     f"{spent.ratio:.2f} times the work of rigid joints; samples with a motor at its limit: "
                     f"{spent.saturated:.0%}"))  # fmt: skip
    motion = free_motion(1, FREE)
    found += _energy("6.energy.bang_bang", "bang-bang, mode 1", bang_bang_energy(motion), 0.45, "set-up of number 5")
    told("time of a step")
    found.append(Row("6.time.limit_cycle", "modal limit cycle on 4 flexible joints, one evaluation of the whole law",
                     "time [us]", None, limit_cycle_time(TURNS), 250.0,
                     f"one core, called from Python, median of {TURNS} turns; via bench controllers"))  # fmt: skip
    return found


def _energy(at: str, words: str, spent: Energy, limit: float | None, setting: str) -> list[Row]:
    settings = f"{SETTINGS}; {setting}; {spent.cycles} cycles"
    return [
        Row(at, f"{words}: {spent.flexible:.3f} J per cycle", RATIO, None, spent.ratio, limit, settings),
        Row(f"{at}.links_only", f"{words}: beside rigid joints whose motors weigh nothing", RATIO, None,
            spent.ratio_links_only, None, settings),
    ]  # fmt: skip
