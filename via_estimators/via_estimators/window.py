"""The sliding window at the door: which samples come in, and the ring that keeps the last of them.

A state of any estimator starts with this header; then follow the ring's times (L,) and its columns (L, k).
"""

from __future__ import annotations

from math import isfinite

from numba import njit
from via_core.signals import Array
from via_core.weak_form import VECTOR, fill_weights

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
def sound(value: float) -> bool:
    """Whether a number can be a signal: finite, and no larger than any joint signal in SI units."""
    return isfinite(value) and abs(value) < LARGEST


@njit(cache=True, error_model="numpy")
def refuse(state: Array) -> int:
    """Count a bad sample; the answer is SKIPPED."""
    state[BAD] += 1.0
    return SKIPPED


@njit(cache=True, error_model="numpy")
def admit(state: Array, times: Array, row: Array, required: int, max_gap: float) -> int:
    """Decide on row = (time, columns...) and, if it comes in, move the ring on by one slot and write its time.

    SKIPPED    one of the first `required` numbers is not finite or absurd, or the stamp does not increase
    RESTARTED  taken as the first sample of a new window: the first of all, after a gap > max_gap [s], or after
               the clock jumped back by more than that (a bag played again)
    TAKEN      taken
    """
    for j in range(required):
        if not (isfinite(row[0]) if j == 0 else sound(row[j])):
            return refuse(state)
    answer = TAKEN
    if state[SAMPLES] == 0.0:
        answer = RESTARTED
    else:
        step = row[0] - state[LAST]
        if abs(step) > max_gap:
            answer = RESTARTED
            state[GAPS] += 1.0
        elif step <= 0.0:
            return refuse(state)
    state[SAMPLES] += 1.0
    state[LAST] = row[0]
    state[FILLED] = 1.0 if answer == RESTARTED else min(state[FILLED] + 1.0, times.size)
    slot = int(state[SLOT]) + 1
    state[SLOT] = slot if slot < times.size else 0
    times[int(state[SLOT])] = row[0]
    return answer


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def weigh(order: int, times: Array, newest: int, psi: Array, held: Array) -> float:
    """Weights of the full window that ends in slot `newest`, by slot; returns its span T [s].

    order  h of the modulating function w_hh
    psi    (3, L) for <f, psi>, <f, psi'>, <f, psi''> of sampled curves
    held   (L,) for <f, psi> of values held over the interval that ends at their stamp: half of that step times the
           values of psi at both its ends, psi_n being the weight psi[0, n] over what the sample stands for
    """
    length, weights = times.size, psi[0]
    oldest = newest + 1 if newest + 1 < length else 0
    fill_weights(order, times, oldest, psi)
    for n in range(2, length - 1):
        before, here = times[n] - times[n - 2], times[n + 1] - times[n - 1]
        held[n] = (times[n] - times[n - 1]) * (weights[n - 1] / before + weights[n] / here)
    # Where the ring's storage begins and ends, and where the window does
    for n in (0, 1, length - 1, oldest + 1, oldest + 2, newest):
        _hold(times, newest, weights, held, n if n < length else n - length)
    held[oldest] = 0.0
    return times[newest] - times[oldest]


@njit(cache=True, error_model="numpy")
def _hold(times: Array, newest: int, weights: Array, held: Array, n: int) -> None:
    """One of the weights `held` of `weigh`, wherever it lies; that of the oldest sample means nothing."""
    length = times.size
    oldest = newest + 1 if newest + 1 < length else 0
    last = n - 1 if n > 0 else length - 1
    start = last - 1 if last > 0 else length - 1
    end = n + 1 if n + 1 < length else 0
    before = times[n] - times[start if last != oldest else oldest]
    here = times[end if n != newest else newest] - times[last]
    held[n] = (times[n] - times[last]) * (weights[last] / before + weights[n] / here)


@njit(cache=True, error_model="numpy")
def spread(values: Array) -> float:
    """Largest minus smallest of values (L,)."""
    low = high = values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    return high - low
