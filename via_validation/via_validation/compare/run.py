"""Run every method in every case, two joints and levels of noise at a time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from via_core.devices import Device
from via_core.errors import ParameterError
from via_estimators.contract import Estimator
from via_estimators.methods import estimator_for, method_for, methods_for
from via_sim.simulate import Simulation

from via_validation.compare.experiment import DURATION, LEVELS, Level, motion_of, seen_by_estimators
from via_validation.compare.figures import Figures, Run, accuracy, figures
from via_validation.compare.parallel import Progress, Report, results_of, within_budget

WRONG = tuple(product((0.8, 1.2), (0.8, 1.2)))  # factors of inertia and damping
WRONG_LEVEL, WRONG_SEEDS = "realistic", 3
BUDGET = 20.0  # [s] processor time of a method per case, from which the number of its seeds follows


@dataclass(frozen=True)
class Case:
    """Results of a method on a joint at a level of noise."""

    method: str
    device: str
    level: str
    figures: Figures
    wrong_motors: float | None  # worst accuracy with wrong inertia and damping; None except at WRONG_LEVEL
    seeds: int  # noise realisations
    cost: float  # [us] processor time per sample over a log, least of the seeds
    example: Run  # the first seed


@dataclass(frozen=True)
class Comparison:
    """Results of all cases."""

    methods: tuple[str, ...]
    devices: tuple[str, ...]
    levels: tuple[Level, ...]
    cases: tuple[Case, ...]  # by device, then level, then method
    defaults: dict[str, str]  # default method by device
    seeds: int  # at most
    budget: float  # [s]

    def case(self, method: str, device: str, level: str) -> Case:
        """The case of a method, a device and a level."""
        return next(c for c in self.cases if (c.method, c.device, c.level) == (method, device, level))

    def of(self, device: str, level: str) -> tuple[Case, ...]:
        """The cases of all methods on a device at a level."""
        return tuple(case for case in self.cases if (case.device, case.level) == (device, level))


@dataclass(frozen=True)
class Effort:
    """How long a comparison may take."""

    seeds: int  # noise realisations per case, at most
    budget: float = BUDGET  # [s]
    duration: float = DURATION  # [s] of a run


@dataclass(frozen=True)
class _Part:
    """A device at a level of noise, with the methods to run on it."""

    device: Device
    level: Level
    methods: tuple[str, ...]
    effort: Effort


def compare(
    devices: Sequence[Device], effort: Effort, progress: Progress, levels: Sequence[Level] = LEVELS
) -> Comparison:
    """Compare all stiffness methods that suit every device. Raises ParameterError if there is none."""
    methods = tuple(
        method
        for method in methods_for(devices[0])
        if all("stiffness" in outputs_of(device, method) for device in devices)
    )
    if not methods:
        raise ParameterError(f"no stiffness estimator suits all of {', '.join(device.name for device in devices)}")
    parts = [_Part(device, level, methods, effort) for device in devices for level in levels]
    found = results_of(_cases, parts, len(parts) * (len(methods) + 1), progress)
    return Comparison(
        methods,
        tuple(device.name for device in devices),
        tuple(levels),
        tuple(case for cases in found for case in cases),
        {device.name: method_for(device) for device in devices},
        effort.seeds,
        effort.budget,
    )


def outputs_of(device: Device, method: str) -> tuple[str, ...]:
    """Outputs of the method on the device; empty if it does not suit the device."""
    return estimator_for(device, method).outputs if method in methods_for(device) else ()


def estimated(estimator: Estimator, simulation: Simulation) -> Run:
    """Estimated and true total stiffness of a simulation."""
    truth = simulation.truth
    return Run.of(estimator.run(simulation.measured), "stiffness", truth.time, truth["stiffness"])


def _cases(part: _Part, report: Report) -> list[Case]:
    """Every method on one device at one level."""
    report(f"{part.device.name}: simulation, {part.level.name}")
    motion = motion_of(part.device, part.level.friction, part.effort.duration)
    measured = [motion.measured(part.level, seed) for seed in range(part.effort.seeds)]
    found = []
    for method in part.methods:
        report(f"{part.device.name}, {part.level.name}: {method}")
        found.append(_case(part, method, measured))
    return found


def _case(part: _Part, method: str, measured: Sequence[Simulation]) -> Case:
    device, level = part.device, part.level
    estimator = estimator_for(seen_by_estimators(device, level), method)
    estimator.load()
    taken = []

    def run(seed: int) -> Run:
        begin = time.process_time()
        found = estimated(estimator, measured[seed])
        taken.append(time.process_time() - begin)
        return found

    runs = within_budget(run, len(measured), part.effort.budget)
    worst = None
    if level.name == WRONG_LEVEL:
        worst = 0.0
        for inertia, damping in WRONG:
            wrong = estimator_for(seen_by_estimators(device, level, inertia, damping), method)
            some = measured[: min(WRONG_SEEDS, len(runs))]
            worst = max(worst, accuracy([estimated(wrong, simulation) for simulation in some]))
    cost = 1e6 * min(taken) / len(measured[0].measured)
    return Case(method, device.name, level.name, figures(runs), worst, len(runs), cost, runs[0])
