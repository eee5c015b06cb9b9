"""A designed excitation with its duration, its verification, and its comparison with the default excitation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError

from via_gap.design.default_motion import excitation
from via_gap.design.excitation_file import Commanded, commanded
from via_gap.design.excite import Candidate, Effort, Goal, Problem, search
from via_gap.design.excite_check import Check, Reached, Verification, preset_of

FIRST = 4.0  # [s] duration of the first search
SHORTEST = 1.0  # [s]
STEP = 1.19  # ratio of two durations tried: four per doubling
CHOOSING = (101, 102, 103)  # seeds that choose the duration; verification has others
SAFE = 0.97  # share of the wanted standard deviation at which the duration is chosen
DIFFERENT = 1.5  # ratio of durations from which the search is repeated at the new one
AT_LIMIT = 0.95  # use of a limit from which it counts as reached
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Comparison:
    """Time [s] until the estimator states the wanted standard deviations, at the presets that both motions visit.

    designed, default  infinite where they are not reached within `within` [s]
    presets            number of presets compared; 0: the default excitation visits none
    """

    designed: float
    default: float
    within: float
    presets: int


@dataclass(frozen=True, eq=False)
class Designed:
    """A designed motion.

    reached   whether stated standard deviations and scatter of the verification are at most those wanted
    binding   limits that the motion uses fully
    """

    problem: Problem
    duration: float
    candidate: Candidate
    commanded: Commanded
    verification: Verification
    comparison: Comparison | None
    reached: bool
    binding: tuple[str, ...]


@dataclass(frozen=True)
class Settings:
    """margin: share of the limits; max_duration [s]; torque_noise [N m]; seeds: number of runs of the verification."""

    margin: float = 0.9
    max_duration: float = 60.0
    torque_noise: float = 0.03
    seeds: int = 8
    effort: Effort = field(default_factory=Effort)


def design(device: Device, goal: Goal, settings: Settings, progress: Progress) -> Designed:
    """The shortest motion found. Raises ParameterError for a device or goal that it does not suit."""
    sensors = device.sensors.model_copy(update={"torque_noise": settings.torque_noise})
    device = device.model_copy(update={"sensors": sensors})
    problem = Problem.of(device, goal, settings.margin, settings.torque_noise)
    check = Check(device, problem.presets if device.n_motors == 2 else problem.presets[:1])
    duration, best = min(FIRST, settings.max_duration), None
    for attempt in (1, 2):
        progress(f"search {attempt} of 2: motions of {duration:.3g} s")
        best = search(problem, duration, settings.effort, None if best is None else best.series)
        before, duration = duration, _duration(problem, check, best, settings, progress)
        if max(duration / before, before / duration) < DIFFERENT:
            break
    assert best is not None
    final = problem.candidate(best.series, duration)
    if final is None:
        raise ParameterError(f"the motion of '{device.name}' does not keep its limits at {duration:.3g} s")
    progress(f"verification with {settings.seeds} seeds")
    made = _commanded(problem, final, duration)
    verification = check.verified(made.commands, settings.seeds, problem.limits.by_name)
    stated = _ratio(goal, verification.stiffness_sd, verification.damping_sd)
    missed = max(stated, _ratio(goal, verification.stiffness_scatter, verification.damping_scatter)) > 1.0
    binding = tuple(name for name, share in verification.used.items() if share >= AT_LIMIT)
    progress("comparison with the default excitation")
    compared = _compared(problem, made, settings) if device.n_motors == 2 else None
    return Designed(problem, duration, final, made, verification, compared, not missed, binding)


def _ratio(goal: Goal, stiffness: float, damping: float) -> float:
    """Largest ratio of stated to wanted standard deviation."""
    return max(stiffness / (goal.stiffness_sd or inf), damping / (goal.damping_sd or inf))


def _commanded(problem: Problem, candidate: Candidate, duration: float) -> Commanded:
    rate = problem.device.sensors.rate * max(1, round(1000.0 / problem.device.sensors.rate))
    return commanded(problem.device, problem.motion(candidate.series, duration, rate))


def _duration(problem: Problem, check: Check, best: Candidate, settings: Settings, progress: Progress) -> float:
    """The shortest duration [s] on a geometric grid at which the estimator states the wanted standard deviations."""
    count = int(np.floor(np.log(settings.max_duration / SHORTEST) / np.log(STEP)))
    grid = [*(SHORTEST * STEP**k for k in range(count + 1)), settings.max_duration]
    low, high = -1, len(grid) - 1  # at `low` not reached, at `high` reached or the longest
    while high - low > 1:
        middle = (low + high) // 2
        candidate = problem.candidate(best.series, grid[middle])
        ratio = inf
        if candidate is not None:
            made = _commanded(problem, candidate, grid[middle])
            runs = [check.reached(*check.run(made.commands, seed)) for seed in CHOOSING]
            ratio = max(_ratio(problem.goal, each.stiffness_sd, each.damping_sd) for each in runs)
        progress(f"  {grid[middle]:.3g} s: {ratio:.3g} of the wanted standard deviation")
        low, high = (low, middle) if ratio <= SAFE else (middle, high)
    return float(grid[high])


def _compared(problem: Problem, made: Commanded, settings: Settings) -> Comparison:
    """Both motions until the estimator states the wanted standard deviations, at the presets that both visit."""
    device, within = problem.device, min(settings.max_duration, 30.0)
    usual = excitation(device, within)
    simulation = Check(device, problem.presets).run(usual, CHOOSING[0])[0]
    visited = preset_of(simulation.measured["theta"], problem.presets)
    # after the first second: the rise from rest crosses every preset once
    low, high = np.quantile(visited[simulation.measured.time > 1.0], (0.01, 0.99))
    common = problem.presets[(problem.presets > low) & (problem.presets < high)]
    if not len(common):
        return Comparison(inf, inf, within, 0)
    check, times = Check(device, common), []
    for commands in (made.commands, usual):
        run, estimates = check.run(commands, CHOOSING[0])
        instants = np.arange(0.5, len(commands) * float(np.diff(commands.time[:2])[0]) + 0.25, 0.25)
        ends: list[Reached] = [check.reached(run, estimates, float(t)) for t in instants]
        good = [_ratio(problem.goal, each.stiffness_sd, each.damping_sd) <= 1.0 for each in ends]
        times.append(float(instants[good.index(True)]) if any(good) else inf)
    return Comparison(times[0], times[1], within, len(common))
