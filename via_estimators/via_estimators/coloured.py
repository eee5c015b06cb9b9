"""Least squares over overlapping windows, with standard deviations that mean what they say.

Every row of a modulated equation is a window over the same raw samples, so neighbouring residuals are almost copies of
one another and the textbook sigma^2 P promises 9-15 times too much. What is known instead is the colour: noise on raw
samples enters row k through the kernel h, hence E[e_k e_(k-d)] = s^2 r_d, r_d = sum_m h_m h_(m+d) if it is white, and

    Cov(x) = P (s^2 M + ...) P,   P = (R'R)^-1,   M = sum_k sum_l w_k w_l F_k F_l' r_(k-l)

M grows by F V' + V F' with V = r_0 F_k / 2 + sum_d r_d F_(k-d): one more FIR over the rows, exact at every sample and
positive semidefinite. Three colours are kept: torque noise (kernel psi), position noise through psi' and psi''. The
torque part is measured: E[RSS] = sum over colours of s_c^2 (W r_0 - tr P M); the position part is declared. RSS
is what the rotations leave over, less what the prior and its leak cost: |x - x_0|^2 + scatter, x_0 where they pull to.

All is in scaled unknowns x_j = (a_j - prior_j) / prior_deviation_j and rows divided by the declared torque noise, so
that the prior is the unit matrix and column scaling comes free. A prior that is no belief but a number to start with
(P(0) of the document) may be narrower than what one believes: `beliefs` holds the variances of x, 1 unless overwritten.
Forgetting would let directions without excitation drift; each step therefore leaks as much as it forgets towards the
current estimate (proximal), which keeps P <= 1 and lets standard deviations grow back to the prior's. The leak holds
on to noise as well as to the estimate, and M is carried along accordingly. The prior counts in full all the while (what
one does not look at may have changed), so in directions hardly excited deviations are rather too large, by up to half.

One equation's state is a flat row; `size` and the index constants below lay it out.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.weak_form import window_weights

from via_estimators.qr import NEGLIGIBLE, inverse_normal, rotate_in, solve_triangular

COLOURS = 3  # psi, psi', psi''
# Sum of weights, RSS with the prior's part, that part's floor, rows, how much M and how much all has yet to fade.
WEIGHT, MISFIT, SCATTER, TAKEN, FADED, PENDING, HEAD = range(7)
FADE = 1e-3  # M is carried along whenever it has this much to fade: every 20th sample, memory 20 s at 1 kHz
PRIOR_WEIGHT = 1.0  # the declared noise counts as much as one independent residual


def colours(intervals: int, order: int, memory: float = 0.0, first: int = 0) -> Array:
    """Autocorrelations (3, H + 1) of the window's weights on torque by psi^(i), on position by psi^(i+1), psi^(i+2).

    intervals  H equidistant steps per window
    order      h of the modulating function w_hh
    memory     correlation time of torque noise in samples (0: white, else exp(-|lag| / memory))
    first      i, how often the equation has been differentiated: 0 or 1

    For a window of length 1; others divide the weights of psi^(i) by T^i.
    """
    kernels = window_weights(order, np.linspace(0.0, 1.0, intervals + 1), COLOURS + first)[first:]
    rows = [np.correlate(h, h, "full") for h in kernels]
    if memory > 0.0:
        lag = np.abs(np.arange(-intervals, intervals + 1))
        rows[0] = np.convolve(rows[0], np.exp(-lag / memory), "same")
    return np.ascontiguousarray([row[intervals:] for row in rows])


@njit(cache=True, error_model="numpy")
def size(n: int, length: int) -> int:
    """Floats in the state of one equation with n unknowns and `length` samples per window."""
    return HEAD + 4 * n + (1 + COLOURS) * n * n + n * length


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int) -> None:
    """Overwrite one equation's state with the prior: x = 0, R = 1, no rows."""
    state[:] = 0.0
    state[FADED] = state[PENDING] = 1.0
    for j in range(n):
        state[HEAD + 4 * n + j * n + j] = 1.0
        state[HEAD + 3 * n + j] = 1.0


@njit(cache=True, error_model="numpy")
def unknowns(state: Array, n: int) -> Array:
    """The view x (n,) into one equation's state."""
    return state[HEAD : HEAD + n]


@njit(cache=True, error_model="numpy")
def beliefs(state: Array, n: int) -> Array:
    """The view (n,) of the variances of x before any data, in units of what the prior R = 1 says."""
    return state[HEAD + 3 * n : HEAD + 4 * n]


@njit(cache=True, error_model="numpy")
def factor(state: Array, n: int) -> Array:
    """The view R (n, n), the triangular factor of the scaled normal equations."""
    return state[HEAD + 4 * n : HEAD + 4 * n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy")
def middles(state: Array, n: int) -> Array:
    """The view M (3, n, n) of the three colours."""
    at = HEAD + 4 * n + n * n
    return state[at : at + COLOURS * n * n].reshape(COLOURS, n, n)


@njit(cache=True, error_model="numpy")
def forget_rows(state: Array, n: int) -> None:
    """Drop the memory of recent rows (after a gap: what follows does not overlap them)."""
    state[HEAD + 4 * n + (1 + COLOURS) * n * n :] = 0.0


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def dot(a: Array, b: Array) -> float:
    """Inner product of two contiguous rows, summed in the order the processor likes (the same every time)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True, error_model="numpy")
def lags(r: Array, slot: int, keep: float, out: Array) -> None:
    """Autocorrelations r (3, L) by lag, forgotten once per lag, laid out by ring slot; lag 0, at `slot`, is halved."""
    length = r.shape[1]
    weight, at = 0.5, slot
    for d in range(length):
        for c in range(COLOURS):
            out[c, at] = weight * r[c, d]
        weight = keep if d == 0 else weight * keep
        at = at - 1 if at > 0 else length - 1


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _transport(R: Array, keep: float, M: Array) -> None:
    """M (3, n, n) after a step of forgetting and leaking: A M A with A = lambda + (1 - lambda) P, P before that step.

    What R'R makes of the error of x is A times what it was, plus the new row's noise. So noise stays in an estimate
    where the leak holds it (P = 1), and is forgotten only where rows replace it (P = 0). Exact for a step of any size,
    as a gap in the record is one.
    """
    n = R.shape[0]
    half, A = np.empty((n, n)), np.empty((n, n))
    inverse_normal(R, half, A)
    for i in range(n):
        for j in range(n):
            A[i, j] *= 1.0 - keep
        A[i, i] += keep
    for c in range(COLOURS):
        half[:, :] = 0.0
        for i in range(n):
            for k in range(n):
                for j in range(n):
                    half[i, j] += A[i, k] * M[c, k, j]
        for i in range(n):
            for j in range(i, n):
                total = 0.0
                for k in range(n):
                    total += half[i, k] * A[j, k]
                M[c, i, j] = total
                M[c, j, i] = total


@njit(cache=True, error_model="numpy")
def forget(state: Array, n: int, keep: float) -> None:
    """One step of forgetting by the factor lambda = keep, in the usual meaning, with the leak that makes up for it.

    Steps that forget next to nothing wait until it is worth the rotations (`qr.NEGLIGIBLE`).
    """
    keep *= state[PENDING]
    if keep > 1.0 - NEGLIGIBLE:
        state[PENDING] = keep
        return
    state[PENDING] = 1.0
    x, p, pulled = state[HEAD : HEAD + n], state[HEAD + n : HEAD + 2 * n], state[HEAD + 2 * n : HEAD + 3 * n]
    R = factor(state, n)
    root, leak = sqrt(keep), sqrt(1.0 - keep)
    state[FADED] *= keep
    if state[FADED] < 1.0 - FADE:
        _transport(R, state[FADED], middles(state, n))
        state[FADED] = 1.0
    p *= root
    R *= root
    state[WEIGHT] *= keep
    state[MISFIT] *= keep
    state[SCATTER] *= keep
    pull = np.zeros(n)
    for j in range(n):
        pull[j] = leak
        state[MISFIT] += rotate_in(R, p, pull, leak * x[j], j) ** 2
        away = x[j] - pulled[j]
        state[SCATTER] += keep * (1.0 - keep) * away * away
        pulled[j] += (1.0 - keep) * away


@njit(cache=True, error_model="numpy")
def skip(state: Array, n: int, slot: int, length: int) -> None:
    """No row this time: leave a hole in the ring of rows."""
    past = state[HEAD + 4 * n + (1 + COLOURS) * n * n :].reshape(n, length)
    past[:, slot] = 0.0


@njit(cache=True, error_model="numpy")
def take(state: Array, n: int, slot: int, row: Array, y: float, lagged: Array) -> None:
    """Take the equation row' x = y; `row` (n,) is overwritten.

    slot    position in the ring of rows, one further each step
    lagged  (3, L) what `lags` made of the autocorrelations
    """
    length = lagged.shape[1]
    x, p, R, M = state[HEAD : HEAD + n], state[HEAD + n : HEAD + 2 * n], factor(state, n), middles(state, n)
    past = state[HEAD + 4 * n + (1 + COLOURS) * n * n :].reshape(n, length)
    past[:, slot] = row
    V = np.empty(n)
    for c in range(COLOURS):
        for j in range(n):
            V[j] = dot(lagged[c], past[j])
        for i in range(n):
            for j in range(n):
                M[c, i, j] += row[i] * V[j] + V[i] * row[j]
    left = rotate_in(R, p, row, y, 0)
    solve_triangular(R, p, x)
    state[WEIGHT] += 1.0
    state[TAKEN] += 1.0
    state[MISFIT] += left * left


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def covariance(state: Array, n: int, r: Array, first: float, second: float, floor: float, out: Array) -> float:
    """Covariance (n, n) of the unknowns x into `out`; returns the variance of the torque noise found.

    first, second  variance of position noise times its squared gain through psi' and psi''
    floor          variance of torque noise that is there in any case: where position noise through psi'' is most of
                   the residuals, they tell nothing of what comes in through psi
    """
    R, M, believed = factor(state, n), middles(state, n), beliefs(state, n)
    middle, P, half = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    inverse_normal(R, middle, P)
    expected = np.empty(COLOURS)
    for c in range(COLOURS):
        explained = 0.0
        for i in range(n):
            for j in range(n):
                explained += P[i, j] * M[c, i, j]
        expected[c] = max(state[WEIGHT] * r[c, 0] - explained, 0.0)
    residual = state[MISFIT] - state[SCATTER]
    for j in range(n):
        residual -= (state[HEAD + j] - state[HEAD + 2 * n + j]) ** 2
    unexplained = max(residual - first * expected[1] - second * expected[2], 0.0)
    noise = max((PRIOR_WEIGHT + unexplained) / (PRIOR_WEIGHT + expected[0]), floor)
    for i in range(n):
        for j in range(n):
            middle[i, j] = noise * M[0, i, j] + first * M[1, i, j] + second * M[2, i, j]
        middle[i, i] += believed[i]  # the prior, and what has leaked since
    half[:, :] = 0.0
    out[:, :] = 0.0
    for i in range(n):
        for k in range(n):
            for j in range(n):
                half[i, j] += P[i, k] * middle[k, j]
    for i in range(n):
        for k in range(n):
            for j in range(n):
                out[i, j] += half[i, k] * P[k, j]
    return noise
