"""The sliding window at the door: which samples come in, and the ring that keeps the last of them.

A state of any estimator starts with this header; then follow the ring's times (L,) and its columns (L, k).
"""

from __future__ import annotations

from math import isfinite

import numpy as np
from numba import njit

from via_core.signals import Array

LAST, FILLED, SLOT, SAMPLES, BAD, GAPS, STATUS, MOTION = range(8)
HEADER = 8
LARGEST = 1e9  # a magnitude no joint signal in SI units reaches; beyond it a number is noise on the wire

TAKEN, SKIPPED, RESTARTED = range(3)


@njit(cache=True, error_model="numpy")
def start(state: Array) -> None:
    """Overwrite the header: nothing seen yet, status WARMING_UP."""
    state[:HEADER] = 0.0
    state[SLOT] = -1.0
    state[STATUS] = 1.0


@njit(cache=True, error_model="numpy")
def admit(state: Array, times: Array, row: Array, required: int, max_gap: float) -> int:
    """Decide on row = (time, columns...) and, if it comes in, move the ring on by one slot and write its time.

    SKIPPED    one of the first `required` numbers is not finite or absurd, or the stamp does not increase
    RESTARTED  taken as the first sample of a new window: the first of all, after a gap > max_gap [s], or after
               the clock jumped back by more than that (a bag played again)
    TAKEN      taken
    """
    for j in range(required):
        if not (isfinite(row[j]) and (j == 0 or abs(row[j]) < LARGEST)):
            state[BAD] += 1.0
            return SKIPPED
    answer = TAKEN
    if state[SAMPLES] == 0.0:
        answer = RESTARTED
    else:
        step = row[0] - state[LAST]
        if abs(step) > max_gap:
            answer = RESTARTED
            state[GAPS] += 1.0
        elif step <= 0.0:
            state[BAD] += 1.0
            return SKIPPED
    state[SAMPLES] += 1.0
    state[LAST] = row[0]
    state[FILLED] = 1.0 if answer == RESTARTED else min(state[FILLED] + 1.0, times.size)
    slot = int(state[SLOT]) + 1
    state[SLOT] = slot if slot < times.size else 0
    times[int(state[SLOT])] = row[0]
    return answer
