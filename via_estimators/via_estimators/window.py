"""Sample validation and ring buffer of a sliding window.

The state of every estimator starts with the slots HEADER, followed by the last values and their standard deviations
(2 k,), the times (L,) of the ring buffer and its columns.
"""

from __future__ import annotations

from math import isfinite

from numba import njit
from via_core.signals import Array
from via_core.status import WARMING_UP
from via_core.weak_form import VECTOR, fill_weights

from via_estimators.slots import slots

# Time of the last sample, samples in the window, newest position in the ring; counters; status; range of motion.
HEADER = slots("last", "filled", "slot", "samples", "bad", "gaps", "status", "motion")
LARGEST = 1e9  # no joint signal in SI units is as large: a larger number is a transmission error

TAKEN, SKIPPED, RESTARTED = range(3)  # results of `admit`


@njit(cache=True, error_model="numpy")
def start(state: Array) -> None:
    """Overwrite the header: no sample yet, status WARMING_UP."""
    state[: HEADER.size] = 0.0
    state[HEADER.slot] = -1.0
    state[HEADER.status] = WARMING_UP


@njit(cache=True, error_model="numpy")
def sound(value: float) -> bool:
    """Whether a number is finite and of a size that a joint signal can have."""
    return isfinite(value) and abs(value) < LARGEST


@njit(cache=True, error_model="numpy")
def refuse(state: Array) -> int:
    """Count a bad sample; returns SKIPPED."""
    state[HEADER.bad] += 1.0
    return SKIPPED


@njit(cache=True, error_model="numpy")
def answer(state: Array, status: int, out: Array) -> None:
    """Write one output row (2 + 2 k,): time of the last valid sample, status, values and standard deviations."""
    out[0], out[1] = state[HEADER.last], status
    for j in range(2, out.size):
        out[j] = state[HEADER.size + j - 2]


@njit(cache=True, error_model="numpy", forceinline=True)
def outputs(state: Array, k: int) -> tuple[Array, Array]:
    """The views of the last values (k,) and standard deviations (k,)."""
    at = HEADER.size
    return state[at : at + k], state[at + k : at + 2 * k]


@njit(cache=True, error_model="numpy", forceinline=True)
def rings(state: Array, at: int, length: int, columns: int) -> tuple[Array, Array]:
    """The views of the times (L,) and columns (columns, L) of the ring buffer, which start at position `at`."""
    return state[at : at + length], state[at + length : at + length * (1 + columns)].reshape(columns, length)


@njit(cache=True, error_model="numpy")
def oldest_of(newest: int, length: int) -> int:
    """Position of the oldest sample in a full ring."""
    return newest + 1 if newest + 1 < length else 0


@njit(cache=True, error_model="numpy")
def admit(state: Array, times: Array, row: Array, required: int, max_gap: float) -> int:
    """Validate row = (time, columns...); if it is valid, advance the ring by one position and write its time.

    SKIPPED    one of the first `required` numbers is not finite or too large, or the stamp does not increase
    RESTARTED  first sample of a new window: the first of all, after a gap > max_gap [s], or after the clock
               jumped back by more than that (a bag played again)
    TAKEN      next sample of the window
    """
    for j in range(required):
        if not (isfinite(row[0]) if j == 0 else sound(row[j])):
            return refuse(state)
    entered = TAKEN
    if state[HEADER.samples] == 0.0:
        entered = RESTARTED
    else:
        step = row[0] - state[HEADER.last]
        if abs(step) > max_gap:
            entered = RESTARTED
            state[HEADER.gaps] += 1.0
        elif step <= 0.0:
            return refuse(state)
    state[HEADER.samples] += 1.0
    state[HEADER.last] = row[0]
    state[HEADER.filled] = 1.0 if entered == RESTARTED else min(state[HEADER.filled] + 1.0, times.size)
    slot = int(state[HEADER.slot]) + 1
    state[HEADER.slot] = slot if slot < times.size else 0
    times[int(state[HEADER.slot])] = row[0]
    return entered


@njit(cache=True, error_model="numpy")
def unroll(ring: Array, oldest: int, out: Array) -> None:
    """Copy a ring (.., L) into out (.., L), oldest first."""
    length = ring.shape[-1]
    for i in range(ring.shape[0]):
        for k in range(length):
            at = oldest + k
            out[i, k] = ring[i, at if at < length else at - length]


@njit(cache=True, error_model="numpy")
def densities(times: Array, newest: int, weights: Array, out: Array) -> None:
    """Half the samples psi_n of the modulating function into out (L,); 0 at both ends of the window.

    weights  (L,) of <f, psi>: psi_n times half the two steps at n

    In storage order, so that the compiler can vectorise the loop.
    """
    last = times.size - 1
    for n in range(1, last):
        out[n] = weights[n] / (times[n + 1] - times[n - 1])
    out[0] = weights[0] / (times[1] - times[last])
    out[last] = weights[last] / (times[0] - times[last - 1])
    out[newest] = out[newest + 1 if newest < last else 0] = 0.0


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def weigh(order: int, times: Array, newest: int, psi: Array, held: Array) -> float:
    """Weights of the full window that ends at position `newest`, by ring position; returns its span T [s].

    order  h of the modulating function w_hh
    psi    (3, L) for <f, psi>, <f, psi'>, <f, psi''> of sampled curves, overwritten
    held   (L,) for <f, psi> of values constant over the interval that ends at their stamp: half of that step times
           the values of psi at both its ends; overwritten
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


@njit(cache=True, error_model="numpy")
def hold_slope(times: Array, newest: int, weights: Array, held: Array) -> None:
    """Weights (L,) for <f, psi'> of values constant over the interval that ends at their stamp: psi_n - psi_(n-1).

    weights  (L,) of <f, psi> for sampled curves, that is psi_n times half the two steps at n
    """
    last = times.size - 1
    densities(times, newest, weights, held)
    across = held[last]
    for n in range(last, 0, -1):
        held[n] = 2.0 * (held[n] - held[n - 1])
    held[0] = 2.0 * (held[0] - across)
    held[newest + 1 if newest < last else 0] = 0.0


@njit(cache=True, error_model="numpy", fastmath={"nnan", "nsz"})
def span_of(values: Array) -> float:
    """Largest minus smallest of values (L,) without NaN, which `admit` has excluded.

    Four comparisons run in parallel, since a chain of comparisons would be slower.
    """
    low = high = values[0]
    quarter = values.size // 4
    for k in range(quarter):
        a, b, c, d = values[k], values[k + quarter], values[k + 2 * quarter], values[k + 3 * quarter]
        low, high = min(low, min(min(a, b), min(c, d))), max(high, max(max(a, b), max(c, d)))
    for k in range(4 * quarter, values.size):
        low, high = min(low, values[k]), max(high, values[k])
    return high - low
