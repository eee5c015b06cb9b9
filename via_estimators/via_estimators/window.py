"""The sliding window at the door: which samples come in, and the ring that keeps the last of them.

A state of any estimator starts with this header; then follow the values told last and their deviations (2 k,), the
ring's times (L,) and its columns.
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
def answer(state: Array, status: int, out: Array) -> None:
    """Fill one row of answers (2 + 2 k,): the time of the last sample taken, the status, values and deviations."""
    out[0], out[1] = state[LAST], status
    for j in range(2, out.size):
        out[j] = state[HEADER + j - 2]


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
    entered = TAKEN
    if state[SAMPLES] == 0.0:
        entered = RESTARTED
    else:
        step = row[0] - state[LAST]
        if abs(step) > max_gap:
            entered = RESTARTED
            state[GAPS] += 1.0
        elif step <= 0.0:
            return refuse(state)
    state[SAMPLES] += 1.0
    state[LAST] = row[0]
    state[FILLED] = 1.0 if entered == RESTARTED else min(state[FILLED] + 1.0, times.size)
    slot = int(state[SLOT]) + 1
    state[SLOT] = slot if slot < times.size else 0
    times[int(state[SLOT])] = row[0]
    return entered


@njit(cache=True, error_model="numpy")
def densities(times: Array, newest: int, weights: Array, out: Array) -> None:
    """psi_n / 2 into out (L,), psi_n being the weight (L,) of <f, psi> over what the sample stands for; 0 at both ends.

    All in the order of storage, so that the compiler can make vector instructions of it.
    """
    last = times.size - 1
    for n in range(1, last):
        out[n] = weights[n] / (times[n + 1] - times[n - 1])
    out[0] = weights[0] / (times[1] - times[last])
    out[last] = weights[last] / (times[0] - times[last - 1])
    out[newest] = out[newest + 1 if newest < last else 0] = 0.0


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def weigh(order: int, times: Array, newest: int, psi: Array, held: Array) -> float:
    """Weights of the full window that ends in slot `newest`, by slot; returns its span T [s].

    order  h of the modulating function w_hh
    psi    (3, L) for <f, psi>, <f, psi'>, <f, psi''> of sampled curves
    held   (L,) for <f, psi> of values held over the interval that ends at their stamp: half of that step times the
           values of psi at both its ends
    """
    last = times.size - 1
    oldest = newest + 1 if newest < last else 0
    fill_weights(order, times, oldest, psi)
    densities(times, newest, psi[0], held)
    across = held[last]
    for n in range(last, 0, -1):
        held[n] = (times[n] - times[n - 1]) * (held[n - 1] + held[n])
    held[0] = (times[0] - times[last]) * (across + held[0])
    held[oldest] = 0.0
    return times[newest] - times[oldest]


@njit(cache=True, error_model="numpy", fastmath={"nnan", "nsz"})
def spread(values: Array) -> float:
    """Largest minus smallest of values (L,), which hold no NaN: `admit` lets none in.

    Four abreast, as one comparison after the other would wait for the one before.
    """
    low = high = values[0]
    quarter = values.size // 4
    for k in range(quarter):
        a, b, c, d = values[k], values[k + quarter], values[k + 2 * quarter], values[k + 3 * quarter]
        low, high = min(low, min(min(a, b), min(c, d))), max(high, max(max(a, b), max(c, d)))
    for k in range(4 * quarter, values.size):
        low, high = min(low, values[k]), max(high, values[k])
    return high - low
