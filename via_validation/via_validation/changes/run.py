"""Run every method on every device under every schedule, two devices at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from math import nan

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_estimators.contract import Estimator
from via_estimators.methods import estimator_for, method_for, methods_for

from via_validation.changes.experiment import Recording, changing_output, description_for_estimators, recording
from via_validation.changes.figures import Outcome, factors, fastest, outcome
from via_validation.changes.schedules import CONSTANT, DURATION, SCHEDULES, SINES, STEP, STEP_TIME, Schedule
from via_validation.compare.figures import Run
from via_validation.compare.parallel import Progress, Report, results_of, within_budget

BUDGET = 10.0  # [s] processor time of a method per device and schedule, from which the number of its seeds follows
SHOWN = (-1.0, 6.0)  # [s] about the step, of the factors drawn
LEAST = 2  # seeds on constant springs: bias and random error need two


@dataclass(frozen=True)
class Followed:
    """A method on a device: outcome by schedule, error of the same method for springs that never change, a step."""

    device: str
    output: str  # that changes
    method: str
    outcomes: dict[str, Outcome]
    steady_error: float  # [-] relative RMS error on constant springs; NaN if no parameter of the method says so
    step: tuple[Array, Array]  # time after the step [s], estimated factor; the first seed

    @property
    def extra(self) -> float:
        """Error on constant springs in addition to that of the method that expects constant springs."""
        return self.outcomes[CONSTANT.name].error - self.steady_error

    @property
    def fastest(self) -> float:
        """Fastest sine followed with status OK [Hz], 0 if none."""
        sines = {each.frequency: self.outcomes[each.name] for each in SINES}
        return fastest({frequency: (each.missed, each.ok) for frequency, each in sines.items()})

    @property
    def weakest(self) -> tuple[str, float]:
        """The schedule with the lowest coverage, and that coverage; NaN without any sample of status OK."""
        known = {name: each.coverage for name, each in self.outcomes.items() if each.coverage == each.coverage}
        return min(known.items(), key=lambda item: item[1], default=("-", nan))


@dataclass(frozen=True)
class Effort:
    """How long a run may take."""

    seeds: int  # noise realisations per schedule, at most
    budget: float = BUDGET  # [s]
    schedules: tuple[Schedule, ...] = SCHEDULES
    duration: float = DURATION  # [s]


def follow(devices: Sequence[Device], effort: Effort, progress: Progress) -> tuple[list[Followed], dict[str, str]]:
    """Results by device and method, and the default method of each device."""
    for device in devices:
        changing_output(device)
    found = results_of(
        _device, [(device, effort) for device in devices], len(devices) * len(effort.schedules), progress
    )
    return [each for part in found for each in part], {device.name: method_for(device) for device in devices}


def methods_that_follow(device: Device) -> tuple[str, ...]:
    """Methods that estimate what changes on the device."""
    output = changing_output(device)
    return tuple(method for method in methods_for(device) if output in estimator_for(device, method).outputs)


def for_constant_springs(estimator: Estimator) -> Estimator | None:
    """The estimator with the parameter that excludes change, at its bound; None if it has no such parameter."""
    ranges = {item.name: item.metadata["range"] for item in fields(estimator.parameters) if "range" in item.metadata}
    for name in ("steadiness", "memory"):
        if name in ranges:
            return estimator.with_parameters(replace(estimator.parameters, **{name: ranges[name][1]}))
    return None


def _device(part: tuple[Device, Effort], report: Report) -> list[Followed]:
    device, effort = part
    methods = methods_that_follow(device)
    if not methods:
        raise ParameterError(f"no method estimates the {changing_output(device)} of '{device.name}'")
    estimators = {method: estimator_for(description_for_estimators(device), method) for method in methods}
    for estimator in estimators.values():
        estimator.load()
    found: dict[str, dict[str, Outcome]] = {method: {} for method in methods}
    steady = dict.fromkeys(methods, nan)
    steps = {method: (np.empty(0), np.empty(0)) for method in methods}
    for schedule in effort.schedules:
        report(f"{device.name}: {schedule.name}")
        joint = recording(device, schedule, effort.duration)
        joint = replace(joint, measured=cache(joint.measured))
        least = LEAST if schedule == CONSTANT else 1
        for method, estimator in estimators.items():
            runs = _runs(estimator, joint, effort, least)
            found[method][schedule.name] = outcome(schedule, runs, joint.unchanged)
            if schedule == CONSTANT and (fixed := for_constant_springs(estimator)) is not None:
                same = replace(effort, seeds=len(runs))
                steady[method] = outcome(schedule, _runs(fixed, joint, same, len(runs)), joint.unchanged).error
            if schedule == STEP:
                time, factor = factors(runs[0], joint.unchanged)
                shown = (time - STEP_TIME >= SHOWN[0]) & (time - STEP_TIME <= SHOWN[1])
                steps[method] = time[shown] - STEP_TIME, factor[shown]
    output = changing_output(device)
    return [Followed(device.name, output, m, found[m], steady[m], steps[m]) for m in methods]


def _runs(estimator: Estimator, joint: Recording, effort: Effort, least: int) -> list[Run]:
    def run(seed: int) -> Run:
        return Run.of(estimator.run(joint.measured(seed)), joint.output, joint.time, joint.truth)

    return within_budget(run, effort.seeds, effort.budget, min(least, effort.seeds))
