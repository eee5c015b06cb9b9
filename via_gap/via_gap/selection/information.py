"""Choice of held-out groups such that fitted and held-out segments contain comparable motion.

The descriptors of a segment are sums of quantities that make parameters identifiable: squared speed, reversals, squared
acceleration, and squared speed in each part of the angle range. Held-out segments are representative if their fraction
of each descriptor is close to SHARE. Groups (a log, the runs of one motion) are held out as a whole.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from via_core.signals import Array, Indices, Mask

SHARE = 0.4  # of the information that is held out: two of five, as in alternating blocks
EXHAUSTIVE = 12  # groups up to which all choices are tried; beyond, single groups are exchanged


def hold_out(information: Array, groups: Sequence[Hashable]) -> Indices:
    """Segments of the groups that are held out, ascending: their part of every descriptor is closest to SHARE.

    information  (S, k) not negative, per segment; a column of zeros is ignored
    groups       (S,) group of each segment

    The choice minimises the largest squared difference from SHARE, then their mean; of equal choices it is the first.
    With one group, or where nothing moves, nothing is held out.
    """
    names = list(dict.fromkeys(groups))
    which = np.array([names.index(group) for group in groups], dtype=np.intp)
    total = information.sum(axis=0)
    seen = total > 0.0
    carried = np.zeros((len(names), information.shape[1]))
    np.add.at(carried, which, information)
    parts = np.divide(carried, total, out=np.zeros_like(carried), where=seen)
    if len(names) < 2 or not seen.any():
        return np.empty(0, dtype=np.intp)
    chosen = (_every if len(names) <= EXHAUSTIVE else _exchanged)(parts[:, seen])
    return np.flatnonzero(chosen[which])


def unlike(information: Array, held: Indices) -> float:
    """Largest difference from SHARE of the part of a descriptor (S, k) that the segments `held` have; 0: alike."""
    total = information.sum(axis=0)
    parts = information[held].sum(axis=0)[total > 0.0] / total[total > 0.0]
    return float(np.max(np.abs(parts - SHARE), initial=0.0))


def describe(angle: Array, speed: Array, cells: int = 4) -> Array:
    """Descriptors (S, 3 + cells) of segments from their angles and speeds (S, n) [rad], [rad/s].

    Squared speed (friction), squared change of speed (inertia), reversals (dry friction, backlash), and squared speed
    in each of `cells` equal parts of the angle range (gravity, springs, torque ripple).
    """
    energy = speed**2
    sign = np.where(np.abs(speed) > 0.1 * np.sqrt(np.mean(energy)), np.sign(speed), 0.0)  # rest is no reversal
    reversals = np.array([float(np.sum(np.diff(row[row != 0.0]) != 0.0)) for row in sign])
    low, high = float(angle.min()), float(angle.max())
    cell = np.clip((cells * (angle - low) / max(high - low, 1e-300)).astype(int), 0, cells - 1)
    within = [np.sum(energy * (cell == k), axis=1) for k in range(cells)]
    return np.column_stack([energy.sum(axis=1), np.sum(np.diff(speed, axis=1) ** 2, axis=1), reversals, *within])


def _cost(shares: Array) -> Array:
    """(..., 2): the largest squared difference of shares (..., k) from the wanted one, and their mean."""
    off = (shares - SHARE) ** 2
    return np.stack([off.max(axis=-1), off.mean(axis=-1)], axis=-1)


def _every(parts: Array) -> Mask:
    """The best of all proper choices of groups."""
    count = len(parts)
    choices = (np.arange(1, 2**count - 1)[:, None] >> np.arange(count)) % 2 == 1
    cost = _cost(choices @ parts)
    return choices[np.lexsort((cost[:, 1], cost[:, 0]))[0]]


def _exchanged(parts: Array) -> Mask:
    """A choice that adding, removing or exchanging single groups does not improve, from alternating groups on."""
    order = np.argsort(-parts.sum(axis=1), kind="stable")
    chosen = np.zeros(len(parts), dtype=bool)
    chosen[order[1::2]] = True
    cost = tuple(_cost(parts[chosen].sum(axis=0)))
    while True:
        moves = [[i] for i in range(len(parts))]
        moves += [[int(i), int(j)] for i in np.flatnonzero(chosen) for j in np.flatnonzero(~chosen)]
        tried = np.tile(chosen, (len(moves), 1))
        for row, move in zip(tried, moves, strict=True):
            row[move] ^= True
        costs = _cost(tried @ parts)
        costs[~tried.any(axis=1) | tried.all(axis=1)] = np.inf
        best = np.lexsort((costs[:, 1], costs[:, 0]))[0]
        if tuple(costs[best]) >= cost:
            return chosen
        chosen, cost = tried[best], tuple(costs[best])
