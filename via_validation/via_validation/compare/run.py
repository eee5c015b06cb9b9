"""Run every method in every case."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from statistics import median

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators.contract import Estimator
from via_estimators.methods import estimator_for, methods_for
from via_sim.simulate import Simulation

from via_validation.compare.experiment import DURATION, LEVELS, Level, Motion, motion_of, seen_by_estimators
from via_validation.compare.figures import Figures, Run, accuracy, figures

WRONG = tuple(product((0.8, 1.2), (0.8, 1.2)))  # factors of inertia and damping
WRONG_LEVEL, WRONG_SEEDS = "realistic", 3
COST_TURNS = 5
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Case:
    """Results of a method on a joint at a level of noise."""

    method: str
    device: str
    level: str
    figures: Figures
    wrong_motors: float | None  # worst accuracy with wrong inertia and damping; None except at WRONG_LEVEL
    example: Run  # the first seed


@dataclass(frozen=True)
class Comparison:
    """Results of all cases."""

    methods: tuple[str, ...]
    devices: tuple[str, ...]
    levels: tuple[Level, ...]
    cases: tuple[Case, ...]  # by method, then device, then level
    cost: dict[str, float]  # [us] per sample over a log, on the first joint
    seeds: int

    def case(self, method: str, device: str, level: str) -> Case:
        """The case of a method, a device and a level."""
        return next(c for c in self.cases if (c.method, c.device, c.level) == (method, device, level))


def compare(
    devices: Sequence[Device],
    seeds: int,
    progress: Progress,
    levels: Sequence[Level] = LEVELS,
    duration: float = DURATION,
) -> Comparison:
    """Compare all stiffness methods that suit every device; `duration` [s]. Raises ParameterError if there is none."""
    methods = tuple(
        method
        for method in methods_for(devices[0])
        if all("stiffness" in outputs_of(device, method) for device in devices)
    )
    if not methods:
        raise ParameterError(f"no stiffness estimator suits all of {', '.join(device.name for device in devices)}")
    cases: dict[tuple[str, str, str], Case] = {}
    done, steps = 0, len(devices) * len(levels) * (len(methods) + 1)

    def report(what: str) -> None:
        nonlocal done
        progress(done, steps, what)
        done += 1

    for device in devices:
        motions: dict[bool, Motion] = {}
        for level in levels:
            report(f"{device.name}: measuring, {level.name}")
            if level.friction not in motions:
                motions[level.friction] = motion_of(device, level.friction, duration)
            measured = [motions[level.friction].measured(level, seed) for seed in range(seeds)]
            for method in methods:
                report(f"{device.name}, {level.name}: {method}")
                cases[method, device.name, level.name] = _case(device, level, method, measured)
    progress(steps, steps, "costs")
    return Comparison(
        methods,
        tuple(device.name for device in devices),
        tuple(levels),
        tuple(cases[m, d.name, lv.name] for m in methods for d in devices for lv in levels),
        {method: cost(devices[0], method) for method in methods},
        seeds,
    )


def outputs_of(device: Device, method: str) -> tuple[str, ...]:
    """Outputs of the method on the device; empty if it does not suit the device."""
    return estimator_for(device, method).outputs if method in methods_for(device) else ()


def estimated(estimator: Estimator, simulation: Simulation) -> Run:
    """Estimated and true total stiffness of a simulation."""
    estimates = estimator.run(simulation.measured)
    value, sd = estimates.column("stiffness")
    truth = simulation.truth["stiffness"]
    return Run(simulation.truth.time, truth, value, sd, estimates.status == Status.OK)


def _case(device: Device, level: Level, method: str, measured: Sequence[Simulation]) -> Case:
    estimator = estimator_for(seen_by_estimators(device, level), method)
    runs = [estimated(estimator, simulation) for simulation in measured]
    worst = None
    if level.name == WRONG_LEVEL:
        worst = 0.0
        for inertia, damping in WRONG:
            wrong = estimator_for(seen_by_estimators(device, level, inertia, damping), method)
            worst = max(worst, accuracy([estimated(wrong, simulation) for simulation in measured[:WRONG_SEEDS]]))
    return Case(method, device.name, level.name, figures(runs), worst, runs[0])


def cost(device: Device, method: str, count: int = 5000) -> float:
    """Median time per sample of a run over a log [us]."""
    estimator = estimator_for(device, method)
    t = np.arange(count) * 1e-3
    columns = [0.3 * np.sin((5.0 + at) * t + at) for at, _ in enumerate(estimator.inputs)]
    rows = np.column_stack([t, *columns])
    state, _ = estimator.run_rows(rows)
    rows[:, 0] += t[-1] + 1e-3
    taken = []
    for _ in range(COST_TURNS):
        begin = time.perf_counter()
        estimator.run_rows(rows, state)
        taken.append(time.perf_counter() - begin)
    return 1e6 * median(taken) / count
