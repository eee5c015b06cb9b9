"""What is fitted and what is judged: whole files, or blocks of the same file that alternate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array

from via_gap.residual.segments import Indices, Shots

BLOCK = 2.0  # [s] at least
SHOTS = 6  # of a block at least
NEAR = 0.02  # [s] to either side of a shot: what happens there shows in it, too
LEAST = 0.02  # of the error of one side that the other has to have
PATTERN = (True, True, False, True, False)  # which of five neighbouring blocks are fitted


def split(shots: Sequence[Shots], holdout: Sequence[Shots]) -> tuple[list[Indices], list[Indices], list[Shots]]:
    """Indices of the shots to fit and to judge, per log of the list returned last (all logs, then the held-out)."""
    everything = [*shots, *holdout]
    valid: list[Indices] = [np.flatnonzero(each.valid) for each in everything]
    none: Indices = np.empty(0, dtype=np.intp)
    if holdout:
        train = [valid[i] if i < len(shots) else none for i in range(len(everything))]
        return train, [none if i < len(shots) else valid[i] for i in range(len(everything))], everything
    size = [max(SHOTS, int(np.ceil(BLOCK * each.rate / each.ticks))) for each in everything]
    if len(everything) > 2 and all(len(v) < 5 * n for v, n in zip(valid, size, strict=True)):
        third = [i % 3 == 2 for i in range(len(everything))]  # of many short logs every third is judged
        train = [none if h else v for v, h in zip(valid, third, strict=True)]
        return train, [v if h else none for v, h in zip(valid, third, strict=True)], everything
    train, held = _by_blocks(valid, size)
    return train, held, everything


def split_finely(shots: Sequence[Shots], events: Sequence[float] = ()) -> tuple[list[Indices], list[Indices]]:
    """Indices of the shots to fit and to judge, of blocks of one shot: for what happens in one place of a log only.

    events  [s since the logs began] of what begins or ends. No other shot tells when: those that hold one are fitted
    """
    train, held = _by_blocks([np.flatnonzero(each.valid) for each in shots], [1] * len(shots))
    for i, each in enumerate(shots):
        begin, span = each.time - each.log.measured.time[0], each.ticks / each.rate
        known = np.array([any(b - NEAR <= event <= b + span + NEAR for event in events) for b in begin], dtype=bool)
        train[i] = np.union1d(train[i], held[i][known[held[i]]])
        held[i] = held[i][~known[held[i]]]
    return train, held


def one_sided(fitted: Array, judged: Array, noise: float) -> bool:
    """Whether what is unexplained, as mean squared errors (S,) of shots, is seen by one side only."""
    sizes = [float(np.mean(np.maximum(each - noise, 0.0))) for each in (fitted, judged)]
    return max(sizes) > noise and min(sizes) < LEAST * max(sizes)


def _by_blocks(valid: Sequence[Indices], size: Sequence[int]) -> tuple[list[Indices], list[Indices]]:
    train: list[Indices] = []
    held: list[Indices] = []
    for which, n in zip(valid, size, strict=True):
        n = max(1, min(n, len(which) // len(PATTERN)))
        fitted = np.array([PATTERN[int(k) // n % len(PATTERN)] for k in which], dtype=bool)
        train.append(which[fitted])
        held.append(which[~fitted])
    return train, held
