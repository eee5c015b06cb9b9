"""Residuals of segments of several logs as a function of device parameters and effects.

values = problem.residual([problem.row(effects, offsets)])     # (K, R) whitened
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_sim.effects import Effect, in_order
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant

from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.nuisance import BOUND, Nuisance, apply_all, descend, nuisances
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Indices, Segments

View = Rollout | InverseDynamics
STEP = 0.01  # relative finite-difference step of a nuisance parameter


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """Residual of several logs of one device under any parameter row; one view (rollout or equation) per log.

    robust  whether the loss of a segment with mean square z^2 is logarithmic above the noise, or z^2
    """

    views: tuple[View, ...]
    plant: JointPlant  # nominal
    nuisances: tuple[Nuisance, ...]
    robust: bool = False

    @staticmethod
    def of(
        segments: Sequence[Segments],
        chosen: Sequence[Indices],
        view: Callable[[Segments, Indices], View] = Rollout.of,
        robust: bool = False,
    ) -> ResidualModel:
        """The model of the segments `chosen` (indices, one array per log) in a view."""
        plant = JointPlant.from_device(segments[0].log.device)
        views = tuple(view(each, which) for each, which in zip(segments, chosen, strict=True) if len(which))
        return ResidualModel(views, plant, nuisances(plant), robust)

    @property
    def device(self) -> Device:
        return self.plant.device

    @property
    def size(self) -> int:
        """Values of a residual, R."""
        return sum(len(view.chosen) * view.size for view in self.views)

    def row(self, effects: Sequence[Effect], offsets: Array | None = None) -> Array:
        """Parameter row (N_PARAMETERS,) of the device with offsets [sd] of its parameters and with effects."""
        row = self.plant.parameters.copy()
        if offsets is not None:
            apply_all(row, self.nuisances, offsets)
        for effect in in_order(effects):
            effect.write(row)
        return row

    def row_or_none(self, effects: Sequence[Effect | None], offsets: Array | None = None) -> Array | None:
        """The row; None if an effect is invalid with these device parameters (a negative friction)."""
        if any(effect is None for effect in effects):
            return None
        try:
            return self.row([effect for effect in effects if effect is not None], offsets)
        except ParameterError:
            return None

    def residual(self, rows: Sequence[Array]) -> Array:
        """Whitened residuals (K, R)."""
        stacked = np.stack(list(rows))
        parts = []
        for view in self.views:
            each = stacked.copy()
            each[:, P.tick], each[:, P.substeps] = view.nominal[P.tick], view.nominal[P.substeps]
            parts.append(view.residual(each).reshape(len(each), -1))
        return np.concatenate(parts, axis=1)

    def loss(self, residual: Array) -> Array:
        """(...,) loss of residuals (..., R), to which a fit adds its squared offsets.

        If robust, a segment whose mean square z^2 exceeds that of noise has 1 + 2 log((1 + z^2) / 2) per value. With
        squares, segments that no model explains would dominate.
        """
        squares = self.per_segment(residual)
        if self.robust:
            squares = np.where(squares > 1.0, 1.0 + 2.0 * np.log(0.5 + 0.5 * np.maximum(squares, 1.0)), squares)
        return np.asarray(squares @ np.repeat([view.size for view in self.views], self._counts))

    def weights(self, residual: Array) -> Array:
        """(R,) weights of iteratively reweighted least squares at a residual (R,).

        The derivative of the loss by z^2 is 2 / (1 + z^2), at most 1. The weighted squares are an upper bound of the
        loss that is tight at `residual`, so that a step that lowers them lowers the loss.
        """
        if not self.robust:
            return np.ones(len(residual))
        slopes = np.minimum(2.0 / (1.0 + self.per_segment(residual)), 1.0)
        return np.asarray(np.sqrt(slopes)[self.segment_of_value()])

    def under(self, change: Callable[[Segments], Segments]) -> ResidualModel:
        """The model of the same segments after a change, for instance of their commands."""
        views: tuple[View, ...] = tuple(type(view).of(change(view.segments), view.chosen) for view in self.views)
        return replace(self, views=views)

    @property
    def by_squares(self) -> ResidualModel:
        """The same with a squared loss, which converges from further away."""
        return replace(self, robust=False) if self.robust else self

    def part(self, kept: Sequence[Indices]) -> tuple[ResidualModel, Indices]:
        """Model of some segments of each view, by their indices into `chosen`, and indices of its values in (R,)."""
        indices, begin = [], 0
        for view, which in zip(self.views, kept, strict=True):
            indices.append((begin + which[:, None] * view.size + np.arange(view.size)).ravel())
            begin += len(view.chosen) * view.size
        views = tuple(b.part(which) for b, which in zip(self.views, kept, strict=True) if len(which))
        return replace(self, views=views), np.concatenate(indices)

    def per_segment(self, residual: Array) -> Array:
        """Mean square (..., S) of a residual (..., R) in each segment; 1: sensor noise alone."""
        parts, begin = [], 0
        for view in self.views:
            size = len(view.chosen) * view.size
            cut = residual[..., begin : begin + size].reshape(*residual.shape[:-1], len(view.chosen), view.size)
            parts.append(np.mean(cut**2, axis=-1))
            begin += size
        return np.concatenate(parts, axis=-1)

    def segment_of_value(self) -> Indices:
        """(R,) index of the segment of each value of a residual, counted over all views."""
        sizes = np.repeat([view.size for view in self.views], self._counts)
        return np.repeat(np.arange(len(sizes)), sizes)

    @property
    def _counts(self) -> list[int]:
        """Segments of each view."""
        return [len(view.chosen) for view in self.views]

    def baseline(self) -> Array:
        """(R,) residual of a prediction without a model, see the views."""
        return np.concatenate([view.baseline().ravel() for view in self.views])

    def nuisance_jacobian(self, effects: Sequence[Effect], offsets: Array, residual: Array) -> Array:
        """(R, J) derivatives of the residual by the offset of each nuisance.

        Steps lead towards offset 0, or away from it if an effect is invalid there; 0 if it is invalid on both sides.
        """
        slopes = np.zeros((len(self.nuisances), len(residual)))
        rows, taken = [], []
        for k, each in enumerate(self.nuisances):
            size = STEP / each.tolerance if offsets[k] <= 0.0 else -STEP / each.tolerance
            for step in (size, -size):
                moved = offsets.copy()
                moved[k] += step
                row = self.row_or_none(effects, moved)
                if row is not None:
                    rows.append(row)
                    taken.append((k, step))
                    break
        if rows:
            which, steps = zip(*taken, strict=True)
            slopes[list(which)] = (self.residual(rows) - residual) / np.array(steps)[:, None]
        return slopes.T

    def fit_nuisances(self, effects: Sequence[Effect], offsets: Array, rounds: int = 3) -> tuple[Array, Array, Array]:
        """Offsets (J,) fitted inside their bounds from `offsets`, their residual (R,), and the last Jacobian (R, J)."""
        residual = self.residual([self.row(effects, offsets)])[0]
        jacobian = self.nuisance_jacobian(effects, offsets, residual)
        for round_ in range(rounds):
            if round_:
                jacobian = self.nuisance_jacobian(effects, offsets, residual)
            pull = self.weights(residual)
            wanted = solve_nuisances(jacobian * pull[:, None], residual * pull, offsets)
            value = self.loss(residual) + offsets @ offsets
            for share in (1.0, 0.5, 0.1):
                trial = offsets + share * (wanted - offsets)
                row = self.row_or_none(effects, trial)
                if row is None:
                    continue
                moved = self.residual([row])[0]
                loss = self.loss(moved) + trial @ trial
                if loss < value:
                    done = value - loss < 1e-3 * loss
                    offsets, residual = trial, moved
                    break
            else:
                break
            if done:
                break
        return offsets, residual, jacobian


def solve_nuisances(jacobian: Array, residual: Array, offsets: Array) -> Array:
    """Offsets (J,) after one bounded Gauss-Newton step."""
    normal = jacobian.T @ jacobian + np.eye(len(offsets))
    gradient = jacobian.T @ (jacobian @ offsets - residual)
    bound = np.full(len(offsets), BOUND)
    return descend(normal, gradient, offsets, -bound, bound)
