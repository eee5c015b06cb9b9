"""Split into fitted and held-out segments: whole logs, or alternating blocks of the same log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array

from via_gap.residual.segments import Indices, Segments
from via_gap.selection.information import describe, hold_out

BLOCK = 2.0  # [s] at least
SEGMENTS = 6  # of a block at least
NEAR = 0.02  # [s] to either side of a segment: an event there has an influence on it
LEAST = 0.02  # smallest ratio of the errors of both sides at which blocks are representative
PATTERN = (True, True, False, True, False)  # which of five neighbouring blocks are fitted


def split(
    segments: Sequence[Segments], holdout: Sequence[Segments]
) -> tuple[list[Indices], list[Indices], list[Segments]]:
    """Indices of fitted and of held-out segments, per log of the list returned last (all logs, then the held-out)."""
    everything = [*segments, *holdout]
    valid: list[Indices] = [np.flatnonzero(each.valid) for each in everything]
    none: Indices = np.empty(0, dtype=np.intp)
    if holdout:
        train = [valid[i] if i < len(segments) else none for i in range(len(everything))]
        return train, [none if i < len(segments) else valid[i] for i in range(len(everything))], everything
    size = [max(SEGMENTS, int(np.ceil(BLOCK * each.rate / each.ticks))) for each in everything]
    if len(everything) > 2 and all(len(v) < 5 * n for v, n in zip(valid, size, strict=True)):
        out = _informative(everything, valid)
        train = [none if h else v for v, h in zip(valid, out, strict=True)]
        return train, [v if h else none for v, h in zip(valid, out, strict=True)], everything
    train, held = _by_blocks(valid, size)
    return train, held, everything


def _informative(segments: Sequence[Segments], valid: Sequence[Indices]) -> list[bool]:
    """Whether each log is held out, such that both sides contain comparable motion."""
    windows = [
        each.begin[which][:, None] + np.arange(min(s.ticks for s in segments)) for each, which in zip(segments, valid)
    ]
    angle = np.concatenate([each.start[w, 0] for each, w in zip(segments, windows, strict=True)])
    speed = np.concatenate([each.start[w, 3] for each, w in zip(segments, windows, strict=True)])
    log_of = np.repeat(np.arange(len(segments)), [len(each) for each in valid])
    held = hold_out(describe(angle, speed), list(map(int, log_of))).held
    if not len(held):  # nothing moves
        return [i % 3 == 2 for i in range(len(segments))]
    return [bool(i in set(log_of[held])) for i in range(len(segments))]


def split_finely(segments: Sequence[Segments], events: Sequence[float] = ()) -> tuple[list[Indices], list[Indices]]:
    """Indices of fitted and of held-out segments in blocks of one segment: for effects that occur once in a log.

    events  [s since the logs began]; segments that contain one are fitted, because no other segment shows its time
    """
    train, held = _by_blocks([np.flatnonzero(each.valid) for each in segments], [1] * len(segments))
    for i, each in enumerate(segments):
        begin, span = each.time - each.log.measured.time[0], each.ticks / each.rate
        known = np.array([any(b - NEAR <= event <= b + span + NEAR for event in events) for b in begin], dtype=bool)
        train[i] = np.union1d(train[i], held[i][known[held[i]]])
        held[i] = held[i][~known[held[i]]]
    return train, held


def one_sided(fitted: Array, held_out: Array, noise: float) -> bool:
    """Whether only one side, given by mean squared errors (S,) of its segments, has errors above the noise."""
    sizes = [float(np.mean(np.maximum(each - noise, 0.0))) for each in (fitted, held_out)]
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
