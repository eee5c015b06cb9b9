"""The largest part of a recording in which time increases."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from via_core.stamps import ordered


def longest(stamps: list[float]) -> int:
    """Length of the longest increasing subsequence, by comparing all pairs."""
    lengths: list[int] = []
    for i, stamp in enumerate(stamps):
        lengths.append(1 + max((lengths[k] for k in range(i) if stamps[k] < stamp), default=0))
    return max(lengths, default=0)


@given(st.lists(st.one_of(st.integers(0, 12).map(float), st.just(float("nan"))), max_size=14))
def test_as_many_samples_as_possible_are_kept(stamps):
    kept, repeated, backward = ordered(np.array(stamps, dtype=float))
    known = [each for each in stamps if np.isfinite(each)]
    assert np.all(np.diff(np.array(stamps)[kept]) > 0.0) and kept.sum() == longest(known)
    left, last = [], []  # stamps that were left out, and whether the last one that was kept is the same
    for k, (each, there) in enumerate(zip(stamps, kept, strict=True)):
        if not there and np.isfinite(each):
            left.append(each)
            last.append(each in np.array(stamps)[:k][kept[:k]][-1:])
    assert repeated == sum(last) and repeated + backward == len(left)


def test_of_equal_stamps_the_first_is_kept():
    assert ordered(np.array([1, 2, 2, 3], dtype=np.int64)).kept.tolist() == [True, True, False, True]


def test_one_stamp_in_the_future_does_not_end_the_recording():
    time = np.arange(7000) * 2e-3
    time[3000] += 1e6
    kept, repeated, backward = ordered(time)
    assert np.flatnonzero(~kept).tolist() == [3000] and (repeated, backward) == (0, 1)
