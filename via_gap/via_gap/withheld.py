"""The gap of one log before and after a repair: what a diagnosis predicted, measured on a log it never saw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_sim.effects import Effect
from via_sim.plants import JointPlant

from via_gap.candidates import Fit
from via_gap.evidence import judge
from via_gap.log import JointLog, believed
from via_gap.measured import Errors, free_errors, shot_errors
from via_gap.nuisance import nuisances
from via_gap.problem import Problem
from via_gap.repaired import repaired_device
from via_gap.report import GapReport
from via_gap.shots import cut_log


def before_and_after(
    log: JointLog, device: Device, effects: Sequence[Effect], report: GapReport | None = None
) -> tuple[Errors, Errors]:
    """Errors of the nominal device, and of the one with `effects` and, where a report is given, its fitted numbers.

    Measured as in the report: in short shots where motors are driven by torque, else in one free run.
    Raises ParameterError where the report is of another device; SignalError where the log cannot be simulated.
    """
    (log,) = believed([log])
    each = nuisances(JointPlant.from_device(device))
    deviations = np.zeros(len(each))
    if report is not None:
        told = {value.name: value.deviations for value in report.nuisance}
        if told.keys() != {nuisance.name for nuisance in each}:
            raise ParameterError(f"the report's numbers are not those of '{device.name}'")
        deviations = np.array([told[nuisance.name] for nuisance in each])
    shots = cut_log(log)
    chosen = [np.flatnonzero(shots.valid)]
    if device.drive == "servo" and device.n_motors:
        nominal = free_errors(device, (), [shots], chosen)
        return nominal, free_errors(repaired_device(device, each, deviations), effects, [shots], chosen)
    problem = Problem.of([shots], chosen)
    nothing = np.empty(0)
    fits = [Fit((), np.zeros(len(each)), 0.0, nothing, nothing), Fit(tuple(effects), deviations, 0.0, nothing, nothing)]
    first, second = judge(problem, fits)
    return shot_errors(problem, first.residual), shot_errors(problem, second.residual)
