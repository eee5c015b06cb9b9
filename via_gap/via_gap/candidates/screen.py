"""Ranking of the candidates by a linear prediction, before any is fitted.

One simulation at each initial value of each candidate gives the direction in which it changes the residual. Candidates
are ranked by the loss that remains after least squares over this direction and the nuisance parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import combinations

import numpy as np
from via_core.devices import Device
from via_core.signals import Array
from via_sim.catalogue.starts import Start

from via_gap.candidates.fit import Fit, Members, effect_or_none
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import amount_range, combined, shapes, starts
from via_gap.residual.nuisance import BOUND, descend
from via_gap.residual.residual_model import ResidualModel

REACH = 12.0  # times the initial value: largest extrapolation of an effect
LEAST = 0.02  # times the initial value: least amount from which a fit starts
REGULAR = 1e-6  # least eigenvalue of a scaled normal matrix that rounding leaves; share of the loss for its rounding
BATCH = 64  # starts that are simulated at once: those of links share the states of motors without an encoder


@dataclass(frozen=True, eq=False)
class Direction:
    """Change (R, k) of a residual by each direction of one start of a candidate."""

    location: Location
    start: Start
    moved: Array


Ranked = list[tuple[float, Location, list[float]]]  # predicted loss, location, values to start from; best first


def directions(problem: ResidualModel, base: Fit, candidates: Sequence[Location], scales: Scales) -> list[Direction]:
    """Every start of every candidate beside the effects of `base`, simulated once; effects of `base` are left out."""
    tried: list[tuple[Location, Start, list[Array]]] = []
    for location in candidates:
        if any(map(location.overlaps, base.locations)):
            continue
        for start in starts(location, scales, problem.device):
            made = [effect_or_none(location, list(direction.values())) for direction in start.directions]
            rows = [problem.row_or_none([*base.effects, effect], base.offsets) for effect in made]
            there = [row for row in rows if row is not None]
            if len(there) == len(start.directions):
                tried.append((location, start, there))
    found = []
    for first in range(0, len(tried), BATCH):
        batch = tried[first : first + BATCH]
        moved = problem.residual([row for _, _, rows in batch for row in rows]) - base.residual
        parts = np.split(moved, np.cumsum([len(rows) for _, _, rows in batch])[:-1])
        found += [Direction(location, start, part.T) for (location, start, _), part in zip(batch, parts, strict=True)]
    return found


def ranked(base: Fit, jacobian: Array, tried: Sequence[Direction], slopes: Array | None = None) -> Ranked:
    """Candidates by the predicted loss with the best amounts of their directions, beside the effects of `base`.

    slopes  (R, k) derivatives of the residual by the effect parameters of `base`, which are then fitted as well: often
            a second cause is visible only if the first can change. None: they are fixed

    The prediction is exact if effects are linear in their amounts and were simulated beside the effects of `base`.
    """
    if slopes is not None and slopes.shape[1]:
        basis = np.linalg.qr(slopes)[0]
        jacobian = jacobian - basis @ (basis.T @ jacobian)
        base = replace(base, residual=base.residual - basis @ (basis.T @ base.residual))
        tried = [replace(each, moved=each.moved - basis @ (basis.T @ each.moved)) for each in tried]
    screen = _Screen.of(base, jacobian, tried)
    alone = map(screen.predicted, combinations(screen.best_starts(), 1))
    return sorted(((loss, location, values) for loss, ((location, values),) in alone), key=lambda each: each[0])


def ranked_pairs(base: Fit, jacobian: Array, tried: Sequence[Direction]) -> Iterator[tuple[float, Members]]:
    """All pairs of candidates by the predicted loss with the best amounts of both, as far as they are asked for.

    Pairs of one effect at a common site are left out. Each candidate is represented by its best start alone. A loss is
    computed once a lower bound of it is less than all losses that are left.
    """
    screen = _Screen.of(base, jacobian, tried)
    pairs = combinations(screen.best_starts(), 2)
    apart = [(one, two) for one, two in pairs if not tried[one].location.overlaps(tried[two].location)]
    bounds = screen.least_losses(apart)
    known: list[tuple[float, int, Members]] = []  # a heap; of equal losses the first pair leads
    for number in np.argsort(bounds, kind="stable"):
        while known and known[0][0] < bounds[number]:
            yield known[0][0], heappop(known)[2]
        loss, members = screen.predicted(apart[number])
        heappush(known, (loss, int(number), members))
    while known:
        yield known[0][0], heappop(known)[2]


def other_starts(fit: Fit, scales: Scales, device: Device) -> list[Members]:
    """The effects of a fit, each in turn with the nonlinear parameters of its other starts."""
    members = fit.members
    return [
        [*members[:number], (location, shape), *members[number + 1 :]]
        for number, (location, values) in enumerate(members)
        for shape in shapes(location, values, scales, device)
    ]


@dataclass(frozen=True, eq=False)
class _Screen:
    """Normal equations of the nuisances (J) and all directions (K), for predicted losses of any of them.

    low    (J + K,) least changes of offsets, and least amounts; high likewise
    first  first column of each start, and the number of columns
    """

    base: Fit
    tried: Sequence[Direction]
    normal: Array
    gradient: Array
    low: Array
    high: Array
    first: Sequence[int]

    @staticmethod
    def of(base: Fit, jacobian: Array, tried: Sequence[Direction]) -> _Screen:
        count = len(base.offsets)
        whole = np.hstack([jacobian, *(each.moved for each in tried)])
        normal, gradient = whole.T @ whole, -(whole.T @ base.residual)
        normal[range(len(normal)), range(len(normal))] += np.where(np.arange(len(normal)) < count, 1.0, 1e-9)
        gradient[:count] -= base.offsets
        ranges = [amount_range(each.location, each.start, REACH) for each in tried]
        low = np.concatenate([-BOUND - base.offsets, *(lows for lows, _ in ranges)])
        high = np.concatenate([BOUND - base.offsets, *(highs for _, highs in ranges)])
        first = count + np.cumsum([0, *(each.moved.shape[1] for each in tried)])
        return _Screen(base, tried, normal, gradient, low, high, [int(each) for each in first])

    def best_starts(self) -> list[int]:
        """Index in `tried` of the best start of each location."""
        best: dict[Location, tuple[float, int]] = {}
        for number, each in enumerate(self.tried):
            loss, _ = self.predicted((number,))
            if each.location not in best or loss < best[each.location][0]:
                best[each.location] = (loss, number)
        return [number for _, number in best.values()]

    def least_losses(self, pairs: Sequence[tuple[int, int]]) -> Array:
        """(n,) lower bounds of the losses that `predicted` finds for pairs: with no limit to amounts and offsets.

        With the offsets eliminated, M = N_kk - N_kj N_jj^-1 N_jk remains of the normal matrix. Minus infinity where M
        of a pair is nearly singular.
        """
        count, size = len(self.base.offsets), len(self.normal) - len(self.base.offsets)
        solved = np.linalg.solve(self.normal[:count, :count], np.c_[self.normal[:count, count:], self.gradient[:count]])
        scale = np.sqrt(np.append(np.diag(self.normal)[count:], 1.0))
        matrix, pull = np.eye(size + 1), np.zeros(size + 1)  # the last one fills up pairs with fewer directions
        matrix[:size, :size] = self.normal[count:, count:] - self.normal[count:, :count] @ solved[:, :-1]
        pull[:size] = self.gradient[count:] - self.normal[count:, :count] @ solved[:, -1]
        matrix, pull = matrix / np.outer(scale, scale), pull / scale
        columns = [
            np.concatenate([np.arange(self.first[each], self.first[each + 1]) for each in pair]) for pair in pairs
        ]
        most = max(map(len, columns), default=0)
        at = np.array([np.append(own - count, np.full(most - len(own), size)) for own in columns], dtype=np.intp)
        if not at.size:
            return np.zeros(len(pairs))
        own = matrix[at[:, :, None], at[:, None, :]]
        values, vectors = np.linalg.eigh(own * ((at[:, :, None] < size) | np.eye(most, dtype=np.bool_)))
        along = np.einsum("nij,ni->nj", vectors, pull[at])
        regular = values[:, 0] > REGULAR
        gain = np.sum(along**2 / np.where(regular[:, None], values, 1.0), axis=1)
        free = self.base.loss - float(self.gradient[:count] @ solved[:, -1])
        return np.where(regular, free - gain - REGULAR * abs(self.base.loss), -np.inf)

    def predicted(self, which: Sequence[int]) -> tuple[float, Members]:
        """Predicted loss with the best amounts of some of `tried` and the best nuisances, and the parameter values."""
        count = len(self.base.offsets)
        columns = [np.arange(self.first[each], self.first[each + 1]) for each in which]
        chosen = np.concatenate([np.arange(count), *columns])
        normal, gradient = self.normal[np.ix_(chosen, chosen)], self.gradient[chosen]
        low, high = self.low[chosen], self.high[chosen]
        step = descend(normal, gradient, np.clip(np.zeros(len(chosen)), low, high), low, high)
        loss = self.base.loss - 2.0 * float(gradient @ step) + float(step @ normal @ step)
        members, parts = [], np.split(step[count:], np.cumsum([len(own) for own in columns])[:-1])
        for each, own, amounts in zip((self.tried[number] for number in which), columns, parts, strict=True):
            if not np.any(np.abs(amounts) > LEAST):
                amounts = np.clip(np.full(len(own), LEAST), self.low[own], self.high[own])
            members.append((each.location, combined(each.location, each.start, amounts.tolist())))
        return loss, members
