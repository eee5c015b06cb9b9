"""Least squares over overlapping windows, with standard deviations that account for the overlap.

Every row of a modulated equation is a window over the same raw samples, so neighbouring residuals are almost equal and
standard deviations by the textbook's sigma^2 P are 9-15 times too small. The autocorrelation (colour) of the residuals
is known: noise on raw samples enters row k through the kernel h, hence E[e_k e_(k-d)] = s^2 r_d, where r_d = sum_m h_m
h_(m+d) if it is white, and

    Cov(x) = P (s^2 M + ...) P,   P = (R'R)^-1,   M = sum_k sum_l w_k w_l F_k F_l' r_(k-l)

M grows by F V' + V F' with V = r_0 F_k / 2 + sum_d r_d F_(k-d): a FIR filter over the rows, exact at every sample and
positive semidefinite. There are three colours: torque noise (kernel psi), position noise through psi' and psi''. The
torque part is measured: E[RSS] = sum over colours of s_c^2 (W r_0 - tr P M); the position part is declared. RSS is the
residual of the rotations less the part of the prior and its leak, |x - x_0|^2 + scatter, x_0 being their target.

Unknowns are scaled, x_j = (a_j - prior_j) / prior_sd_j, and rows are divided by the declared torque noise, so that the
prior is the unit matrix. A prior that is only a starting value (P(0) of the document) may be narrower than what is
known before any data: `beliefs` holds the latter's variances of x, 1 unless overwritten. With forgetting alone,
directions without excitation would drift. Each step therefore adds a pull towards the current estimate of the weight it
forgets (a leak, proximal), which keeps P <= 1 and lets standard deviations grow back to the prior's. The leak preserves
the noise of the estimate too, and M is updated accordingly. The prior keeps its full weight (unobserved parameters may
have changed), so standard deviations are up to half too large in weakly excited directions.

One equation's state is a flat row; `size` and the index constants below define its layout.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.weak_form import window_weights

from via_estimators.qr import NEGLIGIBLE, inverse_normal, reflect_in, rotate_in, solve_triangular
from via_estimators.slots import slots

COLOURS = 3  # psi, psi', psi''
# Sum of weights; RSS including the prior's part; lower bound of that part; rows taken; factors by which M and
# everything have yet to be multiplied.
HEAD = slots("weight", "misfit", "scatter", "taken", "faded", "pending")
FADE = 1e-3  # M is updated when it has to be reduced by this share: every 20th sample, memory 20 s at 1 kHz
PRIOR_WEIGHT = 1.0  # weight of the declared noise, in independent residuals


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


def mirrored(r: Array) -> Array:
    """Autocorrelations r (3, L) by lag, as (3, 2 L) by negative lag, repeated: a slice suits any ring position."""
    return np.ascontiguousarray(np.tile(np.roll(r[:, ::-1], 1, axis=1), 2))


@njit(cache=True, error_model="numpy")
def size(n: int, length: int) -> int:
    """Floats in the state of one equation with n unknowns and `length` samples per window."""
    return HEAD.size + 4 * n + (1 + COLOURS) * n * n + n * length


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int) -> None:
    """Overwrite one equation's state with the prior: x = 0, R = 1, no rows."""
    state[:] = 0.0
    state[HEAD.faded] = state[HEAD.pending] = 1.0
    for j in range(n):
        state[HEAD.size + 4 * n + j * n + j] = 1.0
        state[HEAD.size + 3 * n + j] = 1.0


@njit(cache=True, error_model="numpy")
def scratch(n: int) -> Array:
    """Work space (2 n + 3, n) of the functions below, allocated once since allocations are slow."""
    return np.empty((2 * n + COLOURS, n))


@njit(cache=True, error_model="numpy")
def unknowns(state: Array, n: int) -> Array:
    """The view x (n,) into one equation's state."""
    return state[HEAD.size : HEAD.size + n]


@njit(cache=True, error_model="numpy")
def beliefs(state: Array, n: int) -> Array:
    """The view (n,) of the variances of x before any data, in units of the prior R = 1."""
    return state[HEAD.size + 3 * n : HEAD.size + 4 * n]


@njit(cache=True, error_model="numpy")
def factor(state: Array, n: int) -> Array:
    """The view R (n, n), the triangular factor of the scaled normal equations."""
    return state[HEAD.size + 4 * n : HEAD.size + 4 * n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy")
def middles(state: Array, n: int) -> Array:
    """The view M (3, n, n) of the three colours."""
    at = HEAD.size + 4 * n + n * n
    return state[at : at + COLOURS * n * n].reshape(COLOURS, n, n)


@njit(cache=True, error_model="numpy")
def forget_rows(state: Array, n: int) -> None:
    """Clear the ring of recent rows: after a gap, new rows do not overlap them."""
    state[HEAD.size + 4 * n + (1 + COLOURS) * n * n :] = 0.0


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def dot(a: Array, b: Array) -> float:
    """Inner product of two contiguous rows, summed in a fixed order that the compiler vectorises."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True, error_model="numpy")
def _fade(first: float, keep: float, out: Array) -> None:
    """first keep^d into out (k,), d = 0 in its last place, counted backwards; in eight independent chains."""
    last = out.size - 1
    for d in range(min(8, out.size)):
        out[last - d] = first
        first *= keep
    double = keep * keep
    eight = double * double * double * double
    for m in range(last - 8, -1, -1):
        out[m] = eight * out[m + 8]


@njit(cache=True, error_model="numpy")
def lags(r: Array, slot: int, keep: float, out: Array) -> None:
    """Autocorrelations, forgotten once per lag, laid out (3, L) by ring slot; lag 0, at `slot`, is halved.

    r  (3, 2 L) as `mirrored` has them
    """
    length, weight = out.shape[1], out[0]
    _fade(1.0, keep, weight[: slot + 1])
    _fade(keep * weight[0], keep, weight[slot + 1 :])
    weight[slot] = 0.5
    for c in range(COLOURS - 1, -1, -1):
        by_slot, into = r[c, length - slot : 2 * length - slot], out[c]
        for at in range(length):
            into[at] = weight[at] * by_slot[at]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _along(lagged: Array, past: Array) -> tuple[float, float, float]:
    """Inner products of a ring of one regressor (L,) with the autocorrelations (3, L), in one pass."""
    first = second = third = 0.0
    for m in range(past.size):
        first += lagged[0, m] * past[m]
        second += lagged[1, m] * past[m]
        third += lagged[2, m] * past[m]
    return first, second, third


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _transport(R: Array, keep: float, M: Array) -> None:
    """M (3, n, n) after a step of forgetting and leaking: A M A with A = lambda + (1 - lambda) P, P before that step.

    R'R times the error of x is multiplied by A, and the new row's noise is added. So noise stays in an estimate where
    the leak preserves it (P = 1) and is forgotten only where rows replace it (P = 0). Exact for any step.
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
def forget(state: Array, n: int, keep: float, work: Array) -> None:
    """One step of forgetting by the factor lambda = keep, in the usual meaning, with the leak of the same weight.

    Steps that forget very little are accumulated to save reflections (`qr.NEGLIGIBLE`).

    work  `scratch`
    """
    keep *= state[HEAD.pending]
    if keep > 1.0 - NEGLIGIBLE:
        state[HEAD.pending] = keep
        return
    state[HEAD.pending] = 1.0
    x, p, pulled = state[HEAD.size : HEAD.size + 3 * n].reshape(3, n)
    R = factor(state, n)
    root, leak = sqrt(keep), sqrt(1.0 - keep)
    state[HEAD.faded] *= keep
    if state[HEAD.faded] < 1.0 - FADE:
        _transport(R, state[HEAD.faded], middles(state, n))
        state[HEAD.faded] = 1.0
    p *= root
    R *= root
    state[HEAD.weight] *= keep
    state[HEAD.misfit] *= keep
    state[HEAD.scatter] *= keep
    pulls, y = work[:n], work[n]
    pulls[:, :] = 0.0
    for j in range(n):
        pulls[j, j] = leak
        y[j] = leak * x[j]
        away = x[j] - pulled[j]
        state[HEAD.scatter] += keep * (1.0 - keep) * away * away
        pulled[j] += (1.0 - keep) * away
    state[HEAD.misfit] += reflect_in(R, p, pulls, y, 0)


@njit(cache=True, error_model="numpy")
def skip(state: Array, n: int, slot: int, length: int) -> None:
    """Store zeros instead of a row in the ring of rows."""
    past = state[HEAD.size + 4 * n + (1 + COLOURS) * n * n :].reshape(n, length)
    past[:, slot] = 0.0


@njit(cache=True, error_model="numpy")
def take(state: Array, n: int, slot: int, row: Array, y: float, lagged: Array, work: Array) -> None:
    """Take the equation row' x = y; `row` (n,) is overwritten.

    slot    position in the ring of rows, one further each step
    lagged  (3, L) autocorrelations as `lags` returns them
    work    `scratch`
    """
    length = lagged.shape[1]
    x, p = state[HEAD.size : HEAD.size + n], state[HEAD.size + n : HEAD.size + 2 * n]
    R, M = factor(state, n), middles(state, n)
    past = state[HEAD.size + 4 * n + (1 + COLOURS) * n * n :].reshape(n, length)
    past[:, slot] = row
    for j in range(n):
        work[0, j], work[1, j], work[2, j] = _along(lagged, past[j])
    for c in range(COLOURS):
        V = work[c]
        for i in range(n):
            for j in range(n):
                M[c, i, j] += row[i] * V[j] + V[i] * row[j]
    left = rotate_in(R, p, row, y, 0)
    solve_triangular(R, p, x)
    state[HEAD.weight] += 1.0
    state[HEAD.taken] += 1.0
    state[HEAD.misfit] += left * left


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def noise(state: Array, n: int, r: Array, first: float, second: float, floor: float, work: Array) -> float:
    """Measured variance of the torque noise, in units of the declared one.

    r              (3, L) or more, by lag; only lag 0 is used
    first, second  variance of position noise times its squared gain through psi' and psi''
    floor          lower bound of the result: where residuals are mostly position noise through psi'', they contain no
                   information on noise through psi
    work           `scratch`; P = (R'R)^-1 is left in its first n rows
    """
    M, P = middles(state, n), work[:n]
    inverse_normal(factor(state, n), work[n : 2 * n], P)
    residual = state[HEAD.misfit] - state[HEAD.scatter]
    for j in range(n):
        residual -= (state[HEAD.size + j] - state[HEAD.size + 2 * n + j]) ** 2
    at_rest = 0.0
    for c in range(COLOURS):
        explained = 0.0
        for i in range(n):
            for j in range(n):
                explained += P[i, j] * M[c, i, j]
        expected = max(state[HEAD.weight] * r[c, 0] - explained, 0.0)
        if c == 0:
            at_rest = expected
        else:
            residual -= (first if c == 1 else second) * expected
    return max((PRIOR_WEIGHT + max(residual, 0.0)) / (PRIOR_WEIGHT + at_rest), floor)


@njit(cache=True, error_model="numpy")
def blur(state: Array, n: int, torque: float, first: float, second: float, work: Array) -> None:
    """Covariance (n, n) of the right side of the normal equations, due to noise and the prior, into `work`.

    work  as `noise` leaves it; overwritten after P
    """
    M, believed, middle = middles(state, n), beliefs(state, n), work[n : 2 * n]
    for i in range(n):
        for j in range(n):
            middle[i, j] = torque * M[0, i, j] + first * M[1, i, j] + second * M[2, i, j]
        middle[i, i] += believed[i]  # prior and leak


@njit(cache=True, error_model="numpy")
def _within(M: Array, v: Array) -> float:
    """v' M v of M (n, n), v (n,), at least 0."""
    total = 0.0
    for i in range(v.size):
        total += v[i] * dot(M[i], v)
    return max(total, 0.0)


@njit(cache=True, error_model="numpy")
def variance_of(n: int, j: int, work: Array) -> float:
    """Variance of the unknown x_j; `work` as `blur` leaves it."""
    return float(_within(work[n : 2 * n], work[j]))


@njit(cache=True, error_model="numpy")
def variance(n: int, slope: Array, work: Array) -> float:
    """Variance of slope' x, slope (n,); `work` as `blur` leaves it; its last row is overwritten."""
    through = work[2 * n]
    for i in range(n):
        through[i] = dot(work[i], slope)
    return float(_within(work[n : 2 * n], through))
