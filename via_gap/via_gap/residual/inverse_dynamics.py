"""Logs judged by the torque their link's equation lacks, where runs from measured states say nothing.

A controller holds an arm upright, where the joint alone falls over: run without its controller from a measured state
the model leaves the log within tenths of a second, whatever is wrong with it. And where the missing torque outweighs
inertia, the best model of the *angle* is one that hardly moves (huge inertia, huge damping). The torque that is missing
along the measured motion has neither fault: the drive's torque stands in it with a fixed factor, nothing is run.

    missing = M <q, psi''> - <torque(q, qd, commands; effects), psi>          windows of equations.py

`equation_torques` of via_sim holds every effect as the simulator has it. An `InverseDynamics` stands where a view of
segments does: candidates, evidence and verdict are the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from via_core.errors import SignalError
from via_core.signals import Array
from via_core.weak_form import window_weights
from via_sim.equations import Record, equation_torques
from via_sim.parameters import LINK, P
from via_sim.plants import JointPlant

from via_gap.residual.equations import ORDER, STANDING, STRIDE, WINDOW
from via_gap.residual.segments import Indices, Segments


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Chosen segments of a rigid joint's log, each a row of windows.

    first  (C, w) tick at which each window of each chosen segment begins
    floor  [N m] standard deviation of a window's torque that the encoder explains
    """

    segments: Segments
    chosen: Indices
    nominal: Array  # (N_PARAMETERS,)
    record: Record = field(init=False)
    first: Indices = field(init=False)
    weights: Array = field(init=False)
    floor: float = field(init=False)

    def __post_init__(self) -> None:
        segments, rate = self.segments, self.segments.rate
        ticks = max(5, round(WINDOW * rate) + 1)
        if segments.log.device.n_motors or segments.ticks < ticks:
            raise SignalError(f"{segments.log.name}: the equation of a rigid joint is judged in windows of {WINDOW} s")
        angle, velocity = np.full((2, len(segments.angles), 3), np.nan)
        angle[:, LINK], velocity[:, LINK] = segments.angles[:, 0], segments.start[:, 3]
        time = np.arange(len(angle)) / rate
        weights = window_weights(ORDER, np.arange(ticks) / rate)
        inside = np.arange(0, segments.ticks - ticks + 1, max(1, round(STRIDE * (ticks - 1))))
        set_ = object.__setattr__
        set_(self, "record", Record(time, angle, velocity, time, segments.commands, still=STANDING))
        set_(self, "first", segments.begin[self.chosen][:, None] + inside)
        set_(self, "weights", weights)
        set_(self, "floor", float(self.nominal[P.inertia] * segments.reading[0] * np.sqrt(np.sum(weights[2] ** 2))))

    @staticmethod
    def of(segments: Segments, chosen: Indices) -> InverseDynamics:
        return InverseDynamics(segments, chosen, JointPlant.from_device(segments.log.device).at_rate(segments.rate))

    def part(self, which: Indices) -> InverseDynamics:
        """Some of the segments, by their indices into `chosen`."""
        return InverseDynamics(self.segments, self.chosen[which], self.nominal)

    @property
    def size(self) -> int:
        """Whitened values per segment."""
        return self.first.shape[1]

    def residual(self, rows: Array) -> Array:
        """Missing torque in units of the floor (K, C, w) of rows (K, N_PARAMETERS)."""
        return np.stack([self._missing(row) for row in rows]) / self.floor

    def _missing(self, row: Array) -> Array:
        """(C, w) [N m]; where the link nearly stands, dry friction takes what it can."""
        told = equation_torques(row, self.record)
        gliding = self.over(told.torque[:, LINK] + told.friction[:, LINK], 0)
        missing = told.inertia[LINK] * self.over(told.angle[:, LINK], 2) - gliding
        slipping = missing + self.over(told.friction[:, LINK], 0)
        standing = sliding_window_view(told.standing[:, LINK], self.weights.shape[1])[self.first].any(axis=-1)
        capacity = self.over(told.capacity[:, LINK], 0)
        held = np.sign(missing) * np.maximum(np.abs(missing) - capacity, 0.0)
        return np.where(standing, held, slipping)

    def over(self, values: Array, derivative: int) -> Array:
        """Integral of values (T,) against a derivative of psi, over each window (C, w)."""
        return sliding_window_view(values, self.weights.shape[1])[self.first] @ self.weights[derivative]
