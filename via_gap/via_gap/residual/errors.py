"""Size of the gap: errors of the simulated signals, per signal and over all.

A torque-driven joint is simulated in short segments from measured states, because a free run drifts. A joint with
servos is simulated over the whole log, as its user does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from via_core.devices import Device
from via_core.signals import Array, Indices, Signals
from via_sim.effects import Effect

from via_gap.logs.between import acting
from via_gap.logs.replay import simulated_log
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments

BLOCK = 2.0  # [s] of a free run that are resampled together
RESAMPLES = 400
Run = Callable[[Signals, Signals], Signals]


@dataclass(frozen=True, eq=False)
class Errors:
    """Squared errors per signal and block, and the variances to which they are relative.

    names     of the signals
    squares   (B, n) mean squared error of each block [rad^2]
    variance  (n,) of the measured signals [rad^2]
    floor     (n,) mean square of sensor noise [rad^2]
    """

    names: tuple[str, ...]
    squares: Array
    variance: Array
    floor: Array

    @property
    def signals(self) -> Array:
        """(n,) gap of each signal."""
        return np.sqrt(self.squares.mean(axis=0) / self.variance)

    @property
    def overall(self) -> float:
        return float(np.sqrt(np.mean(self.squares.mean(axis=0) / self.variance)))

    @property
    def floors(self) -> Array:
        return np.sqrt(self.floor / self.variance)

    def resampled(self, seed: int = 0) -> Array:
        """(RESAMPLES,) overall gaps of resampled blocks."""
        pick = np.random.default_rng(seed).integers(0, len(self.squares), (RESAMPLES, len(self.squares)))
        return np.sqrt(np.mean(self.squares[pick].mean(axis=1) / self.variance, axis=1))


def torque_errors(problem: ResidualModel, residual: Array) -> Errors:
    """Errors from missing torques (R,) in units of their floors; squares and variances in [N^2 m^2]."""
    squares, drives, floors = [], [], []
    for view, values in zip(problem.views, problem.by_view(residual), strict=True):
        assert isinstance(view, InverseDynamics)
        squares.append(np.mean(view.torques(values) ** 2, axis=2))
        drives.append(view.windows.drive[view.first.ravel()])
        floors.append(view.windows.floor**2)
        axes = view.windows.axes
    names = ("tau",) if axes == (0,) else tuple("tau_link" if axis == 0 else f"tau_{axis}" for axis in axes)
    variance = np.maximum(np.var(np.concatenate(drives), axis=0), 1e-12)
    return Errors(names, np.concatenate(squares), variance, np.mean(floors, axis=0))


NAMES = ("q", "theta_1", "theta_2")


def segment_errors(problem: ResidualModel, residual: Array) -> Errors:
    """Errors from a whitened residual (R,) of the problem's segments."""
    axes = problem.views[0].segments.axes
    squares, measured = [], []
    for view, values in zip(problem.views, problem.by_view(residual), strict=True):
        each = values.reshape(len(values), -1, len(axes))
        squares.append(np.mean(each**2, axis=1) * view.segments.noise**2)
        measured.append(view.segments.measured[view.chosen].reshape(-1, len(axes)))
    variance = np.maximum(np.var(np.concatenate(measured), axis=0), 1e-12)
    noise = problem.views[0].segments.noise
    return Errors(tuple(NAMES[a] for a in axes), np.concatenate(squares), variance, noise**2)


def free_errors(
    device: Device, effects: Sequence[Effect], segments: Sequence[Segments], chosen: Sequence[Indices]
) -> Errors:
    """Errors of the link angle in free runs over every log; only samples in the chosen segments count."""
    return run_errors(device, partial(simulated_log, device, effects=effects), segments, chosen)


def run_errors(device: Device, run: Run, segments: Sequence[Segments], chosen: Sequence[Indices]) -> Errors:
    """`free_errors` of a simulator `run` of whole logs: (measured, commands) -> signals with `q`."""
    squares, total, count = [], 0.0, 0
    for each, which in zip(segments, chosen, strict=True):
        if not len(which):
            continue
        log = each.log
        commands = acting(log)
        assert commands is not None
        simulated = run(log.measured, commands)
        seen = np.isfinite(log.measured["q"])
        time, q = log.measured.time[seen], log.measured["q"][seen]
        error = q - np.interp(time, simulated.time, simulated["q"])
        inside = np.isin(np.searchsorted(each.time, time, side="right") - 1, which)
        blocks = max(1, round(log.duration / BLOCK))  # of equal length, because all count alike
        block = np.minimum((time - time[0]) / log.duration * blocks, blocks - 1).astype(int)
        for b in np.unique(block[inside]):
            squares.append([float(np.mean(error[inside & (block == b)] ** 2))])
        total += float(np.sum((q[inside] - np.mean(q[inside])) ** 2))
        count += int(np.sum(inside))
    quantum = device.sensors.link_quantum or 0.0
    return Errors(("q",), np.array(squares), np.array([max(total / count, 1e-12)]), np.array([quantum**2 / 12.0]))
