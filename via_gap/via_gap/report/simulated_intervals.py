"""Held-out samples in a row, measured and simulated by two models: the data behind traces and errors by region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.devices import Device
from via_core.signals import Array, Indices, Mask
from via_sim.effects import Effect

from via_gap.logs.between import acting
from via_gap.logs.replay import simulated_log
from via_gap.residual.errors import NAMES
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments


@dataclass(frozen=True, eq=False)
class SimulatedInterval:
    """Consecutive held-out samples.

    time      (N,) [s] since the log began
    states    (N, 6) [rad, rad/s] smoothed; NaN: not measured
    measured, before, after  (N, a) [rad] of `axes`; of equations the drive's torque [N m]
    restarts  (N,) whether the simulation restarts at a sample
    floor     (a,) rms that sensor noise explains, in the same unit
    torque    whether inverse dynamics is compared and not a simulation
    """

    log: str
    axes: tuple[int, ...]
    time: Array
    states: Array
    measured: Array
    before: Array
    after: Array
    restarts: Mask
    floor: Array
    torque: bool = False

    def signal(self, axis: int) -> str:
        """Name of the compared signal of an axis."""
        if not self.torque:
            return NAMES[axis]
        return "tau" if self.axes == (0,) else "tau_link" if axis == 0 else f"tau_{axis}"

    def part(self, begin: int, end: int) -> SimulatedInterval:
        """The samples from `begin` to before `end`."""
        names = ("time", "states", "measured", "before", "after", "restarts")
        return replace(self, **{name: getattr(self, name)[begin:end] for name in names})


def runs(indices: Indices) -> list[Indices]:
    """Positions of consecutive indices, one array per run."""
    positions = np.arange(len(indices))
    return [run for run in np.split(positions, np.flatnonzero(np.diff(indices) != 1) + 1) if len(run)]


def segment_intervals(problem: ResidualModel, before: Array, after: Array) -> list[SimulatedInterval]:
    """Neighbouring segments of a problem, with whitened residuals (R,) of two simulations.

    The part of an error that the noise of the segment's start explains is not counted, as in the gap: 'simulated' is
    the measured angle minus the remaining error.
    """
    found = []
    for view, *two in zip(problem.views, problem.by_view(before), problem.by_view(after), strict=True):
        segments = view.segments
        errors = [each.reshape(len(each), -1, len(segments.axes)) * segments.noise for each in two]
        for run in runs(view.chosen):
            measured = segments.measured[view.chosen[run]]
            bins = measured.shape[1]
            ticks = (segments.begin[view.chosen[run]][:, None] + segments.every * np.arange(1, bins + 1)).ravel()
            flat = measured.reshape(-1, len(segments.axes))
            first, second = (flat - each[run].reshape(flat.shape) for each in errors)
            restarts = np.arange(len(ticks)) % bins == 0
            found.append(
                SimulatedInterval(segments.log.name, segments.axes, ticks / segments.rate, segments.start[ticks], flat,
                                 first, second, restarts, segments.noise)
            )  # fmt: skip
    return found


def torque_intervals(problem: ResidualModel, before: Array, after: Array) -> list[SimulatedInterval]:
    """Neighbouring segments in inverse dynamics, with the missing torque (R,) of two models."""
    found = []
    for view, *two in zip(problem.views, problem.by_view(before), problem.by_view(after), strict=True):
        assert isinstance(view, InverseDynamics)
        segments, windows, missing = view.segments, view.windows, [view.torques(each) for each in two]
        sent = np.stack([view.over(windows.drive[view.inside, i], 0) for i in range(len(windows.axes))], axis=1)
        for run in runs(view.chosen):
            ticks = (view.first[run] + windows.weights.shape[1] // 2).ravel()
            flat, first, second = (
                each[run].transpose(0, 2, 1).reshape(len(ticks), -1)
                for each in (sent, sent + missing[0], sent + missing[1])
            )
            found.append(
                SimulatedInterval(segments.log.name, windows.axes, ticks / segments.rate, segments.start[ticks], flat,
                                 first, second, np.zeros(len(ticks), dtype=bool), windows.floor, True)
            )  # fmt: skip
    return found


def free_intervals(
    nominal: Device,
    repaired: Device,
    effects: Sequence[Effect],
    segments: Sequence[Segments],
    chosen: Sequence[Indices],
) -> list[SimulatedInterval]:
    """Held-out intervals of logs that are simulated from beginning to end; the link angle only."""
    found = []
    floor = np.array([(nominal.sensors.link_quantum or 0.0) / np.sqrt(12.0)])
    for each, which in zip(segments, chosen, strict=True):
        log = each.log
        commands = acting(log)
        if not len(which) or commands is None:
            continue
        seen = np.isfinite(log.measured["q"])
        time, q = log.measured.time[seen], log.measured["q"][seen]
        models = ((nominal, ()), (repaired, effects))
        two = [simulated_log(device, log.measured, commands, added) for device, added in models]
        before, after = (np.interp(time, run.time, run["q"])[:, None] for run in two)
        segment = np.clip(np.searchsorted(each.time, time, side="right") - 1, 0, len(each) - 1)
        inside = np.flatnonzero(np.isin(segment, which))
        ticks = np.clip(np.rint((time - each.origin) * each.rate).astype(int), 0, len(each.start) - 1)
        for run in runs(inside):
            at = inside[run]
            found.append(
                SimulatedInterval(log.name, (0,), time[at] - time[0], each.start[ticks[at]], q[at, None], before[at],
                                 after[at], np.zeros(len(at), dtype=bool), floor)
            )  # fmt: skip
    return found
