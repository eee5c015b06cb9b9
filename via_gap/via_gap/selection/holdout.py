"""Split into fitted and held-out segments: whole logs, or alternating blocks of the same log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array, Indices

from via_gap.residual.segments import Segments
from via_gap.selection.information import SHARE, describe, hold_out, unlike
from via_gap.selection.numbers import NUMBERS

BLOCK = 2.0  # [s] at least
SEGMENTS = 6  # of a block at least
LEAST = 0.02  # smallest ratio of the errors of both sides at which blocks are representative
ALIKE = 0.5 * SHARE  # difference of parts of the motion up to which it is comparable: half of the share
PATTERN = (True, True, False, True, False)  # which of five neighbouring blocks are fitted

Sides = tuple[list[Indices], list[Indices]]  # of each log the segments that are fitted, and those held out


def split(
    segments: Sequence[Segments], holdout: Sequence[Segments]
) -> tuple[list[Indices], list[Indices], list[Segments]]:
    """Indices of fitted and of held-out segments, per log of the list returned last (all logs, then the held-out)."""
    everything = [*segments, *holdout]
    valid: list[Indices] = [np.flatnonzero(each.valid) for each in everything]
    size = [max(SEGMENTS, int(np.ceil(BLOCK * each.rate / each.ticks))) for each in everything]
    if holdout:
        return *_whole(valid, [i >= len(segments) for i in range(len(everything))]), everything
    blocks = _by_blocks(valid, size)
    if len(everything) > 2 and all(len(v) < 5 * n for v, n in zip(valid, size, strict=True)):
        return *_comparable(everything, valid, blocks), everything
    return *blocks, everything


def _whole(valid: Sequence[Indices], out: Sequence[bool]) -> Sides:
    """Both sides if whole logs are held `out`."""
    none: Indices = np.empty(0, dtype=np.intp)
    train, held = ([v if h == side else none for v, h in zip(valid, out, strict=True)] for side in (False, True))
    return train, held


def _comparable(segments: Sequence[Segments], valid: Sequence[Indices], blocks: Sides) -> Sides:
    """Whole logs are held out if they contain motion comparable to the others, or at least as much so as `blocks`.

    Three recordings of sines, ramps and steps do not: if the one with steps is held out, a torque limit is seen where
    nothing is fitted.
    """
    ticks = np.arange(min(each.ticks for each in segments))
    motion = [each.start[each.begin[which][:, None] + ticks] for each, which in zip(segments, valid, strict=True)]
    angle, speed = (np.concatenate([each[..., slot] for each in motion]) for slot in (0, 3))
    log_of = np.repeat(np.arange(len(segments)), list(map(len, valid)))
    information = describe(angle, speed)
    out = hold_out(information, log_of.tolist())
    in_blocks = np.concatenate([np.isin(which, held) for which, held in zip(valid, blocks[1], strict=True)])
    if len(out) and unlike(information, out) <= max(ALIKE, unlike(information, np.flatnonzero(in_blocks))):
        held = set(log_of[out].tolist())
        return _whole(valid, [i in held for i in range(len(segments))])
    return blocks


def split_finely(segments: Sequence[Segments], events: Sequence[float] = ()) -> Sides:
    """Indices of fitted and of held-out segments in blocks of one segment: for effects that occur once in a log.

    events  [s since the logs began]; segments that contain one, and their neighbours, are on both sides: no other
            segment shows its time, and a short push would leave no held-out segment that shows it
    """
    train, held = _by_blocks([np.flatnonzero(each.valid) for each in segments], [1] * len(segments))
    for i, each in enumerate(segments):
        begin, span = each.time - each.log.measured.time[0], each.ticks / each.rate
        known = np.array([any(b - span <= event <= b + 2.0 * span for event in events) for b in begin], dtype=bool)
        both = np.intersect1d(np.flatnonzero(known), np.union1d(train[i], held[i]))
        train[i], held[i] = np.union1d(train[i], both), np.union1d(held[i], both)
    return train, held


def one_sided(fitted: Array, held_out: Array) -> bool:
    """Whether only one side, given by mean squared errors (S,) of its segments, has errors above the noise."""
    noise = NUMBERS.no_gap
    sizes = [float(np.mean(np.maximum(each - noise, 0.0))) for each in (fitted, held_out)]
    return max(sizes) > noise and min(sizes) < LEAST * max(sizes)


def lopsided(fitted: Array, held_out: Array) -> bool:
    """`one_sided` without the worst segment of each side: other blocks cannot share out a single segment."""
    if min(len(fitted), len(held_out)) < 2:
        return False
    return one_sided(np.sort(fitted)[:-1], np.sort(held_out)[:-1])


def _by_blocks(valid: Sequence[Indices], size: Sequence[int]) -> Sides:
    long = [max(1, min(n, len(which) // len(PATTERN))) for which, n in zip(valid, size, strict=True)]
    blocks = [which // n for which, n in zip(valid, long, strict=True)]
    before = np.cumsum([0, *(int(each[-1]) + 1 if len(each) else 0 for each in blocks)])  # short logs share a pattern
    fitted = [np.array(PATTERN)[(each + past) % len(PATTERN)] for each, past in zip(blocks, before, strict=False)]
    pairs = list(zip(valid, fitted, strict=True))
    return [which[kept] for which, kept in pairs], [which[~kept] for which, kept in pairs]
