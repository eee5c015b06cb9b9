"""Screen of the candidates: which of them could explain the residual, before any is fitted.

One simulation at each start of each candidate gives the direction in which the effect changes the residual. How much of
the residual lies in that direction, after the nuisance parameters have taken their part, ranks the candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from via_core.signals import Array

from via_gap.candidates.fit import Fit, Members, effect_or_none
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import Start, amount_range, combined, starts
from via_gap.residual.nuisance import BOUND, descend
from via_gap.residual.residual_model import ResidualModel

REACH = 12.0  # times its start: how far the screen extrapolates an effect
LEAST = 0.02  # times its start: with less of an effect a fit would not find its way
BATCH = 16  # starts that are simulated at once


@dataclass(frozen=True, eq=False)
class Direction:
    """What one start of a candidate does: change (R, k) of a residual by each of its directions."""

    location: Location
    start: Start
    moved: Array


Ranked = list[tuple[float, Location, list[float]]]  # predicted loss, location, values to start from; best first


def directions(problem: ResidualModel, base: Fit, candidates: Sequence[Location], scales: Scales) -> list[Direction]:
    """Every start of every candidate beside the effects of `base`, but for those that are there, simulated once."""
    tried: list[tuple[Location, Start, list[Array]]] = []
    for location in candidates:
        if any(map(location.overlaps, base.locations)):
            continue
        for start in starts(location, scales, problem.device):
            rows = [
                problem.row_or_none([*base.effects, effect_or_none(location, list(direction.values()))], base.offsets)
                for direction in start.directions
            ]
            there = [row for row in rows if row is not None]
            if len(there) == len(start.directions):
                tried.append((location, start, there))
    found = []
    for first in range(0, len(tried), BATCH):
        batch = tried[first : first + BATCH]
        moved = problem.residual([row for _, _, rows in batch for row in rows]) - base.residual
        at = 0
        for location, start, made in batch:
            found.append(Direction(location, start, moved[at : at + len(made)].T))
            at += len(made)
    return found


def ranked(base: Fit, jacobian: Array, tried: Sequence[Direction], slopes: Array | None = None) -> Ranked:
    """Candidates by the loss that the best amounts of their directions would leave of `base`'s residual (R,).

    slopes  (R, k) of the residual along what `base`'s effects may give way: a cause that is to join them often shows
            only once they stand elsewhere. None: they stay

    Where an effect is not linear in its amounts, the true simulation of the result would be better or worse than
    predicted, which `refine` finds out. Directions simulated beside other effects than those of `base` tell roughly.
    """
    if slopes is not None and slopes.shape[1]:
        basis = np.linalg.qr(slopes)[0]
        jacobian = jacobian - basis @ (basis.T @ jacobian)
        base = replace(base, residual=base.residual - basis @ (basis.T @ base.residual))
        tried = [replace(each, moved=each.moved - basis @ (basis.T @ each.moved)) for each in tried]
    screen = _Screen.of(base, jacobian, tried)
    alone = map(screen.left, combinations(screen.best_starts(), 1))
    return sorted(((loss, location, values) for loss, ((location, values),) in alone), key=lambda each: each[0])


def ranked_pairs(base: Fit, jacobian: Array, tried: Sequence[Direction]) -> list[tuple[float, Members]]:
    """Every two candidates by the loss that the best amounts of both together would leave, as `ranked` does each alone.

    No effect is put twice at one place: at motor 1 and at both motors.

    Of each candidate only the start that is best alone is combined with others.
    """
    screen = _Screen.of(base, jacobian, tried)
    pairs = [
        (one, two)
        for one, two in combinations(screen.best_starts(), 2)
        if not tried[one].location.overlaps(tried[two].location)
    ]
    return sorted(map(screen.left, pairs), key=lambda each: each[0])


@dataclass(frozen=True, eq=False)
class _Screen:
    """Normal equations of the nuisances (J) and all directions tried (K): what any of these would leave together.

    low    (J + K,) ends of what nuisances and amounts may do; high likewise
    first  columns at which the directions of each begin, and where the last end
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
        """For each location the one start that is best alone, by its index in `tried`."""
        best: dict[Location, tuple[float, int]] = {}
        for number, each in enumerate(self.tried):
            loss, _ = self.left((number,))
            if each.location not in best or loss < best[each.location][0]:
                best[each.location] = (loss, number)
        return [number for _, number in best.values()]

    def left(self, which: Sequence[int]) -> tuple[float, Members]:
        """Predicted loss with the best amounts of some of `tried` and the nuisances moved along, and their values."""
        count = len(self.base.offsets)
        columns = [np.arange(self.first[each], self.first[each + 1]) for each in which]
        chosen = np.concatenate([np.arange(count), *columns])
        normal, gradient = self.normal[np.ix_(chosen, chosen)], self.gradient[chosen]
        low, high = self.low[chosen], self.high[chosen]
        step = descend(normal, gradient, np.clip(np.zeros(len(chosen)), low, high), low, high)
        loss = self.base.loss - 2.0 * float(gradient @ step) + float(step @ normal @ step)
        members, at = [], count
        for number, own in zip(which, columns, strict=True):
            amounts, each = step[at : at + len(own)], self.tried[number]
            at += len(own)
            if not np.any(np.abs(amounts) > LEAST):
                amounts = np.clip(np.full(len(own), LEAST), self.low[own], self.high[own])
            members.append((each.location, combined(each.location, each.start, [float(a) for a in amounts])))
        return loss, members
