"""Residuals of segments of several logs as a function of device parameters and effects.

values = problem.residual([problem.row(effects, offsets)])     # (K, R) whitened
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Indices, Mask
from via_sim.effects import Effect, in_order
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant

from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.nuisance import (
    BOUND,
    Nuisance,
    apply_all,
    delay_between_samples,
    descend,
    lowest_offsets,
    nuisances,
    repaired_device,
)
from via_gap.residual.rollout import Rollout, residuals
from via_gap.residual.segments import Segments

View = Rollout | InverseDynamics
T = TypeVar("T")
Asks = Generator[Sequence[Array], Array, T]  # yields parameter rows (K, N_PARAMETERS), is sent their residuals (K, R)
MOST_ROWS = 64  # rows of several computations that are simulated at once: more need memory and fill no more lanes
STEP = 0.01  # relative finite-difference step of a nuisance parameter


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """Residual of several logs of one device under any parameter row; one view (rollout or equation) per log.

    robust      whether the loss of a segment with mean square z^2 is logarithmic above the noise, or z^2
    importance  (S,) factor of the loss of each segment; None: 1
    """

    views: tuple[View, ...]
    plant: JointPlant  # nominal
    nuisances: tuple[Nuisance, ...]
    robust: bool = False
    importance: Array | None = None

    @staticmethod
    def of(
        segments: Sequence[Segments],
        chosen: Sequence[Indices],
        view: Callable[[Segments, Indices], View] = Rollout.of,
        robust: bool = False,
    ) -> ResidualModel:
        """The model of the segments `chosen` (indices, one array per log) in a view."""
        views = tuple(view(each, which) for each, which in zip(segments, chosen, strict=True) if len(which))
        nominal = ResidualModel.of_plant(JointPlant.from_device(segments[0].log.device))
        known = (*nominal.nuisances, *delay_between_samples(segments[0].log))
        return replace(nominal, views=views, nuisances=known, robust=robust)

    @staticmethod
    def of_plant(plant: JointPlant) -> ResidualModel:
        """The model of no segments: it makes parameter rows."""
        return ResidualModel((), plant, nuisances(plant))

    @property
    def device(self) -> Device:
        return self.plant.device

    @property
    def delays(self) -> Mask:
        """(J,) whether a nuisance is the delay of commands between samples."""
        return np.array([P.delay in each.slots for each in self.nuisances], dtype=np.bool_)

    def repaired(self, offsets: Array) -> Device:
        """The device with offsets (J,) [sd] of its parameters."""
        return repaired_device(self.device, self.nuisances, offsets)

    @property
    def size(self) -> int:
        """Values of a residual, R."""
        return int(self._sizes.sum())

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
        stacked = [np.stack(list(rows)) for _ in self.views]
        for view, each in zip(self.views, stacked, strict=True):
            each[:, [P.tick, P.substeps]] = view.segments.nominal[[P.tick, P.substeps]]
        rollouts = [view for view in self.views if isinstance(view, Rollout)]
        if len(rollouts) == len(self.views):
            parts = residuals(rollouts, stacked)
        else:
            parts = [view.residual(each) for view, each in zip(self.views, stacked, strict=True)]
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)

    def loss(self, residual: Array) -> Array:
        """(...,) loss of residuals (..., R), to which a fit adds its squared offsets: of every measured value.

        If robust, a segment whose mean square z^2 exceeds that of noise has 1 + 2 log((1 + z^2) / 2) per value. With
        squares, segments that no model explains would dominate.
        """
        return np.asarray(self.losses(residual).sum(axis=-1))

    def losses(self, residual: Array) -> Array:
        """(..., S) loss of each segment of residuals (..., R)."""
        squares = self.per_segment(residual)
        if self.robust:
            squares = np.where(squares > 1.0, 1.0 + 2.0 * np.log(0.5 + 0.5 * np.maximum(squares, 1.0)), squares)
        return np.asarray(squares * self._amounts)

    def weights(self, residual: Array) -> Array:
        """(R,) weights of iteratively reweighted least squares at a residual (R,).

        The derivative of the loss by z^2 is 2 / (1 + z^2), at most 1, times the share of the values that were measured:
        those of a segment with gaps are larger by it. The weighted squares are an upper bound of the loss that is tight
        at `residual`, so that a step that lowers them lowers the loss.
        """
        slopes = self._amounts / self._sizes
        if self.robust:
            slopes = slopes * np.minimum(2.0 / (1.0 + self.per_segment(residual)), 1.0)
        return np.asarray(np.sqrt(slopes)[self.segment_of_value()])

    def under(self, change: Callable[[Segments], Segments]) -> ResidualModel:
        """The model of the same segments after a change, for instance of their commands."""
        views: tuple[View, ...] = tuple(type(view).of(change(view.segments), view.chosen) for view in self.views)
        return replace(self, views=views)

    def at_likely_starts(self, row: Array) -> ResidualModel:
        """The model linearised about the most likely start of each segment under a row; equations have no starts."""
        views = tuple(each.at_likely_starts(row) if isinstance(each, Rollout) else each for each in self.views)
        return replace(self, views=views)

    @property
    def by_squares(self) -> ResidualModel:
        """The same with a squared loss, which converges from further away."""
        return replace(self, robust=False) if self.robust else self

    def part(self, kept: Sequence[Indices]) -> tuple[ResidualModel, Indices]:
        """Model of some segments of each view, by their indices into `chosen`, and indices of its values in (R,)."""
        places = zip(self.by_view(np.arange(self.size)), kept, strict=True)
        views = tuple(b.part(which) for b, which in zip(self.views, kept, strict=True) if len(which))
        own = self.importance
        if own is not None:
            before = np.cumsum([0, *(len(view.chosen) for view in self.views)])
            own = own[np.concatenate([first + which for first, which in zip(before, kept, strict=False)])]
        found = np.concatenate([each[which].ravel() for each, which in places])
        return replace(self, views=views, importance=own), found

    def touched(self, spans: Array) -> list[Indices]:
        """Of each view, indices into `chosen` of the segments in any of the spans (2, n) [s since the run began]."""
        found = []
        for view in self.views:
            segments = view.segments
            begin = segments.nominal[P.origin] + segments.begin[view.chosen, None] / segments.rate
            inside = (begin <= spans[1]) & (begin + segments.ticks / segments.rate >= spans[0])
            found.append(np.flatnonzero(inside.any(axis=1)))
        return found

    def by_view(self, residual: NDArray[Any]) -> list[NDArray[Any]]:
        """The values (..., segments, values per segment) of each view in a residual (..., R)."""
        ends = np.cumsum([len(view.chosen) * view.size for view in self.views])
        parts = zip(np.split(residual, ends[:-1], axis=-1), self.views, strict=True)
        return [part.reshape(*part.shape[:-1], len(view.chosen), view.size) for part, view in parts]

    def per_segment(self, residual: Array) -> Array:
        """Mean square (..., S) of a residual (..., R) in each segment; 1: sensor noise alone."""
        return np.concatenate([np.mean(each**2, axis=-1) for each in self.by_view(residual)], axis=-1)

    def squares(self, effects: Sequence[Effect], offsets: Array) -> Array:
        """(S,) of `per_segment` with these effects and fitted device parameters `offsets` (J,)."""
        return self.per_segment(self.residual([self.row(effects, offsets)])[0])

    def evidence(self, residual: Array) -> Array:
        """Mean square (..., E) of a residual (..., R) in each segment, with one value for all segments of one rest."""
        return self.once_per_rest(self.per_segment(residual))

    def once_per_rest(self, squares: Array) -> Array:
        """(..., S) of segments -> (..., E): neighbours that show one rest are one value, their mean.

        A joint that is held for a minute answers one question, whether it rests there, not 80 times the same.
        """
        ends = np.cumsum([0, *(len(view.segments) for view in self.views)])
        rests = [end + view.segments.rest_from[view.chosen] for end, view in zip(ends, self.views, strict=False)]
        first, count = np.unique(np.concatenate(rests), return_index=True, return_counts=True)[1:]
        return np.asarray(np.add.reduceat(squares, first, axis=-1) / count)

    def segment_of_value(self) -> Indices:
        """(R,) index of the segment of each value of a residual, counted over all views."""
        return np.repeat(np.arange(len(self._sizes)), self._sizes)

    @property
    def _sizes(self) -> Indices:
        """(S,) number of values of each segment."""
        return np.repeat([view.size for view in self.views], [len(view.chosen) for view in self.views])

    @cached_property
    def _counts(self) -> Indices:
        """(S,) number of values of each segment that were measured."""
        return np.concatenate([_measured(view) for view in self.views])

    @property
    def _amounts(self) -> Array:
        """(S,) what the mean square of each segment counts in the loss."""
        return np.asarray(self._counts if self.importance is None else self._counts * self.importance)

    @property
    def measured(self) -> int:
        """Number of measured values of all segments."""
        return int(self._counts.sum())

    def baseline(self) -> Array:
        """(R,) residual of a prediction without a model, see the views."""
        return np.concatenate([view.baseline().ravel() for view in self.views])

    def answer(self, asking: Sequence[Asks[T]]) -> list[T]:
        """What computations return that ask for residuals; those of all of them are simulated side by side."""
        found: dict[int, T] = {}
        asked: dict[int, Sequence[Array]] = {}

        def go_on(number: int, step: Callable[[], Sequence[Array]]) -> None:
            try:
                asked[number] = step()
            except StopIteration as end:
                found[number] = end.value

        for number, each in enumerate(asking):
            go_on(number, partial(next, each))
        while asked:
            together: dict[int, Sequence[Array]] = {}
            while asked and (not together or sum(map(len, together.values())) < MOST_ROWS):
                number = next(iter(asked))
                together[number] = asked.pop(number)
            residuals = self.residual([row for rows in together.values() for row in rows])
            ends = np.cumsum([len(rows) for rows in together.values()])
            for number, own in zip(together, np.split(residuals, ends[:-1]), strict=True):
                go_on(number, partial(asking[number].send, own))
        return [found[number] for number in range(len(asking))]

    def nuisance_jacobian(self, effects: Sequence[Effect], offsets: Array, residual: Array) -> Array:
        """(R, J) derivatives of the residual by the offset of each nuisance, see `nuisance_slopes`."""
        return self.answer([self.nuisance_slopes(effects, offsets, residual)])[0]

    def nuisance_slopes(self, effects: Sequence[Effect], offsets: Array, residual: Array) -> Asks[Array]:
        """(R, J) derivatives of the residual by the offset of each nuisance.

        Steps lead towards offset 0, or away from it if an effect is invalid there; 0 if it is invalid on both sides.
        """
        slopes = np.zeros((len(self.nuisances), len(residual)))
        moved: list[tuple[int, float, Array]] = []
        for k, (each, unit) in enumerate(zip(self.nuisances, np.eye(len(offsets)), strict=True)):
            size = STEP / each.tolerance if offsets[k] <= 0.0 else -STEP / each.tolerance
            tries = ((step, self.row_or_none(effects, offsets + step * unit)) for step in (size, -size))
            moved += [(k, step, row) for step, row in tries if row is not None][:1]
        if moved:
            which, steps, rows = zip(*moved, strict=True)
            slopes[list(which)] = ((yield rows) - residual) / np.array(steps)[:, None]
        return slopes.T

    def fit_nuisances(self, effects: Sequence[Effect], offsets: Array, rounds: int = 3) -> tuple[Array, Array]:
        """Offsets (J,) fitted inside their bounds from `offsets` by Gauss-Newton, and their residual (R,)."""
        low, high = lowest_offsets(self.nuisances), np.full(len(offsets), BOUND)
        residual = self.residual([self.row(effects, offsets)])[0]
        for _ in range(rounds):
            jacobian = self.nuisance_jacobian(effects, offsets, residual)
            pull = self.weights(residual)
            slopes = jacobian * pull[:, None]
            normal = slopes.T @ slopes + np.eye(len(offsets))
            wanted = descend(normal, slopes.T @ (slopes @ offsets - residual * pull), offsets, low, high)
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
        return offsets, residual


def _measured(view: View) -> Indices:
    """(C,) number of values of each chosen segment that do not lie in a gap of the samples."""
    if isinstance(view, Rollout):
        return np.count_nonzero(view.segments.weight[view.chosen], axis=(1, 2))
    return np.count_nonzero(view.weight, axis=1) * len(view.windows.axes)
