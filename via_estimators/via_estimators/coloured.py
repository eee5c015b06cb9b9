"""Least squares over overlapping windows, with standard deviations that mean what they say.

Every row of a modulated equation is a window over the same raw samples, so neighbouring residuals are almost copies of
one another and the textbook sigma^2 P promises 9-15 times too much. What is known instead is the colour: white noise on a
raw sample enters row k through the kernel h, hence E[e_k e_(k-d)] = s^2 r_d with r the autocorrelation of h, and

    Cov(x) = P (s^2 M + ...) P,   P = (R'R)^-1,   M = sum_k sum_l w_k w_l F_k F_l' r_(k-l)

M grows by F V' + V F' with V = r_0 F_k / 2 + sum_d r_d F_(k-d): one more FIR over the rows, exact at every sample and
positive semidefinite. Three colours are kept: torque-like noise (kernel psi) and position noise through the second and
the first derivative (psi'', psi'). s^2 comes from the residuals, for which E[RSS] = sum over colours s_c^2 (W r_0 - tr P M).

Everything is in scaled unknowns x_j = (a_j - prior_j) / prior_deviation_j and rows divided by the declared torque noise, so
the prior is the unit matrix and column scaling comes free. Forgetting would let directions without excitation drift;
each row therefore leaks as much as it forgets towards the current estimate (proximal), which keeps P <= 1.

One equation's state is a flat row; `size` and the index constants below lay it out.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from via_core.signals import Array
from via_estimators.qr import inverse_normal, rotate_in, solve_triangular

COLOURS = 3  # psi, psi', psi''
WEIGHT, RESIDUAL, ROWS, EXPECTED = 0, 1, 2, 3  # sum of weights, weighted RSS, rows taken, (3,) E[RSS] at warm-up
HEAD = EXPECTED + COLOURS
PRIOR_WEIGHT = 1.0  # the declared noise counts as much as one independent residual


@njit(cache=True, error_model="numpy")
def size(n: int, length: int) -> int:
    """Floats in the state of one equation with n unknowns and `length` samples per window."""
    return HEAD + n + n + n * n + COLOURS * n * n + length * n


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int) -> None:
    """Overwrite one equation's state with the prior: x = 0, R = 1, no rows."""
    state[:] = 0.0
    for j in range(n):
        state[HEAD + 2 * n + j * n + j] = 1.0


@njit(cache=True, error_model="numpy")
def unknowns(state: Array, n: int) -> Array:
    """The view x (n,) into one equation's state."""
    return state[HEAD : HEAD + n]


def factor(state: Array, n: int) -> Array:
    """The view R (n, n), the triangular factor of the scaled normal equations."""
    return state[HEAD + 2 * n : HEAD + 2 * n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy")
def forget_rows(state: Array, n: int) -> None:
    """Drop the memory of recent rows (after a gap: what follows does not overlap them)."""
    state[HEAD + 2 * n + (1 + COLOURS) * n * n :] = 0.0


@njit(cache=True, error_model="numpy")
def take(state: Array, n: int, slot: int, row: Array, y: float, keep: float, used: bool, warm: int, r: Array) -> None:
    """One time step of one equation: forget, leak, and, where `used`, take the row' x = y.

    slot  position in the ring of rows, one further each call
    keep  forgetting factor lambda of this step, in the usual meaning
    warm  rows before residuals count towards the noise estimate
    r     (3, length) autocorrelations of the kernels of the three colours
    """
    length = r.shape[1]
    x = state[HEAD : HEAD + n]
    p = state[HEAD + n : HEAD + 2 * n]
    at = HEAD + 2 * n
    R = state[at : at + n * n].reshape(n, n)
    M = state[at + n * n : at + (1 + COLOURS) * n * n].reshape(COLOURS, n, n)
    past = state[at + (1 + COLOURS) * n * n :].reshape(length, n)
    if keep < 1.0:
        root = sqrt(keep)
        for j in range(n):
            p[j] *= root
            for i in range(j, n):
                R[j, i] *= root
        M *= keep * keep
        state[WEIGHT] *= keep
        state[RESIDUAL] *= keep
        for c in range(COLOURS):
            state[EXPECTED + c] *= keep
        leak = sqrt(1.0 - keep)
        scratch = np.zeros(n)
        for j in range(n):
            scratch[j] = leak
            rotate_in(R, p, scratch, leak * x[j], j)
    if not used:
        past[slot, :] = 0.0
        return
    past[slot, :] = row
    V = np.zeros((COLOURS, n))
    weight = 1.0
    at_slot = slot
    for d in range(length):
        half = 0.5 * weight if d == 0 else weight
        for c in range(COLOURS):
            along = half * r[c, d]
            for j in range(n):
                V[c, j] += along * past[at_slot, j]
        weight *= keep
        at_slot = at_slot - 1 if at_slot > 0 else length - 1
    for c in range(COLOURS):
        for i in range(n):
            for j in range(n):
                M[c, i, j] += row[i] * V[c, j] + V[c, i] * row[j]
    left = rotate_in(R, p, row, y, 0)
    solve_triangular(R, p, x)
    state[WEIGHT] += 1.0
    state[ROWS] += 1.0
    if state[ROWS] > warm:
        state[RESIDUAL] += left * left
    elif state[ROWS] == warm:
        inverse, P = np.empty((n, n)), np.empty((n, n))
        inverse_normal(R, inverse, P)
        for c in range(COLOURS):
            state[EXPECTED + c] = state[WEIGHT] * r[c, 0] - _trace(P, M[c])


@njit(cache=True, error_model="numpy")
def _trace(P: Array, M: Array) -> float:
    total = 0.0
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            total += P[i, j] * M[j, i]
    return total


@njit(cache=True, error_model="numpy")
def covariance(state: Array, n: int, r: Array, first: float, second: float, out: Array) -> float:
    """Covariance (n, n) of the unknowns x into `out`; returns the variance of the torque-like noise found.

    first, second  variance of position noise times its squared gain through psi' and psi''
    """
    at = HEAD + 2 * n
    R = state[at : at + n * n].reshape(n, n)
    M = state[at + n * n : at + (1 + COLOURS) * n * n].reshape(COLOURS, n, n)
    inverse, P = np.empty((n, n)), np.empty((n, n))
    inverse_normal(R, inverse, P)
    expected = np.empty(COLOURS)
    for c in range(COLOURS):
        expected[c] = max(state[WEIGHT] * r[c, 0] - _trace(P, M[c]) - state[EXPECTED + c], 0.0)
    unexplained = max(state[RESIDUAL] - first * expected[1] - second * expected[2], 0.0)
    noise = (PRIOR_WEIGHT + unexplained) / (PRIOR_WEIGHT + expected[0])
    middle = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            middle[i, j] = noise * M[0, i, j] + first * M[1, i, j] + second * M[2, i, j]
        middle[i, i] += 1.0  # the prior, and what has leaked since
    half = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += P[i, k] * middle[k, j]
            half[i, j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += half[i, k] * P[k, j]
            out[i, j] = total
    return noise
