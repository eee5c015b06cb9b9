"""Least squares on the integrated motor equation, with standard deviations that mean what they say.

Source: SAPHARI deliverable, eqs. (36)-(49), as corrected: integrated from a base t_0 up to t,

    B thd(t) + D theta(t) - sum_j a_j I_j(t) + c = T(t),   I_j = integral f_j(phi),   T = integral tau

with the minus that (39) lost and with the constant c = -B thd(t_0) - D theta(t_0) that (36) lost, an unknown here. The
motor's acceleration does not occur.

**The base moves with the clock.** Integrals from a fixed base grow without bound. But a base moved by the increments
dI, dT (and angles counted from now on, dtheta) adds multiples of the constant's column to the others,

    row' = row S,  S = 1 + e_0 s',   s = (0, 0, -dtheta, dI_1, ..),   y' = y - dT row_0

so with the constant in column 0 only row 0 of the triangular factor R changes: R_0j += R_00 s_j, p_0 -= R_00 dT. What
is known stays exactly what it was, and the newest row is (1, thd, 0, .., 0) with y = 0, whatever day it is. Where the
motion stops or the record has a gap the constant is done with: dropping row 0 of R eliminates it exactly.

**Noise.** White torque noise e_n of variance r^2 is a random walk in T, so neighbouring rows err alike and (R'R)^-1 is
far too small. Seen from the moving base it is simple: the newest row has no error, and each step adds -dt e_n to every
older one. With the weighted sum of rows v = R_00 R_0, all of it known, the gradient's covariance obeys exactly

    M <- lambda^2 (S'MS + dt^2 (S'v)(S'v)'),   Cov(x) = P (r^2 M + prior) P,   P = (R'R)^-1

White noise on the velocity sensor enters row by row, V <- lambda^2 S'VS + F F'. Both are measured on increments of the
equation: torque noise is white there, and what velocity noise v adds to one it takes from the next, B (v_n - v_(n-1)).
N sums products of increments, L those of neighbours, so that misfit and its correlation are those of the present
unknowns: x'Lx tells the velocity noise, x'Nx + x'Lx the torque noise r^2.

Unknowns are scaled, x_j = (a_j - prior_j) / prior_deviation_j, the constant aside, so that the prior is a unit matrix.
Each step leaks towards the present estimate as much as it forgets (proximal): P <= 1, and without excitation standard
deviations grow back to those of the prior, no further. Errors of the angles are not in these equations beyond what they
look like on the torque: noise on phi and theta also pulls estimates towards 0, which no covariance tells.
"""

from __future__ import annotations

from math import sqrt

from numba import njit
from via_core.signals import Array

from via_estimators.qr import rotate_in, solve_transposed, solve_triangular

WEIGHT, TAKEN, HEAD = range(3)  # sum of the weights of increments; rows taken
PRIOR_WEIGHT = 1.0  # the declared noise counts as much as one increment
CLEAR = 4.0  # deviations; that of r^2 in velocity noise is sqrt(2 / W) of the increments' variance, W their number
BASE = 1e-12  # R_00 without any row: the constant has no prior


@njit(cache=True, error_model="numpy")
def size(n: int) -> int:
    """Floats in the state of one equation with n unknowns, the constant among them."""
    return HEAD + 3 * n + 5 * n * n


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int) -> None:
    """Overwrite one equation's state with the prior: x = 0, R = 1 but for the constant, no rows."""
    state[:] = 0.0
    R = factor(state, n)
    R[0, 0] = BASE
    for j in range(1, n):
        R[j, j] = 1.0


@njit(cache=True, error_model="numpy")
def unknowns(state: Array, n: int) -> Array:
    """The view x (n,), the constant first."""
    return state[HEAD : HEAD + n]


@njit(cache=True, error_model="numpy")
def matrix(state: Array, n: int, which: int) -> Array:
    """View (n, n) of R, M, V, N or L: which = 0, 1, 2, 3, 4."""
    at = HEAD + 3 * n + which * n * n
    return state[at : at + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy")
def factor(state: Array, n: int) -> Array:
    """The view R (n, n), the triangular factor of the scaled normal equations."""
    return matrix(state, n, 0)


@njit(cache=True, error_model="numpy")
def _move(M: Array, s: Array) -> None:
    """M (n, n) <- S'MS with S = 1 + e_0 s', s_0 = 0."""
    n = s.size
    corner = M[0, 0]
    for i in range(1, n):
        for j in range(1, n):
            M[i, j] += s[i] * M[0, j] + M[i, 0] * s[j] + corner * s[i] * s[j]
    for i in range(1, n):
        M[0, i] += corner * s[i]
        M[i, 0] = M[0, i]


@njit(cache=True, error_model="numpy")
def rebase(state: Array, n: int, s: Array, pushed: float, step: float) -> None:
    """Move the base of all rows taken to now.

    s       (n,) what is added to each column per unit of the constant's column, s_0 = 0
    pushed  dT, the integral of the torque over the step, in the units of y
    step    [s] its duration over the torque noise's unit: the error of dT per unit of noise
    """
    p, R = state[HEAD + n : HEAD + 2 * n], factor(state, n)
    M, V = matrix(state, n, 1), matrix(state, n, 2)
    base = R[0, 0]
    for j in range(1, n):
        R[0, j] += base * s[j]
    p[0] -= base * pushed
    _move(M, s)
    _move(V, s)
    for i in range(n):
        for j in range(n):
            M[i, j] += (step * base) ** 2 * R[0, i] * R[0, j]


@njit(cache=True, error_model="numpy")
def eliminate(state: Array, n: int) -> None:
    """Drop the constant: rows to come have another one. Everything known about the rest stays."""
    p, R = state[HEAD + n : HEAD + 2 * n], factor(state, n)
    for which in (1, 2):
        M = matrix(state, n, which)
        for i in range(1, n):  # G M G', G = (-R_0j / R_00, 1)
            for j in range(1, n):
                a, b = R[0, i] / R[0, 0], R[0, j] / R[0, 0]
                M[i, j] += a * b * M[0, 0] - a * M[0, j] - b * M[i, 0]
        M[0, :] = 0.0
        M[:, 0] = 0.0
    R[0, :] = 0.0
    R[0, 0] = BASE
    p[0] = 0.0
    state[HEAD] = 0.0


@njit(cache=True, error_model="numpy")
def forget(state: Array, n: int, keep: float, pull: Array) -> None:
    """One step of forgetting by the factor lambda = keep, in the usual meaning, with the leak that makes up for it.

    pull  (n,) overwritten
    """
    if keep == 1.0:
        return
    x, p, R = state[HEAD : HEAD + n], state[HEAD + n : HEAD + 2 * n], factor(state, n)
    root, leak = sqrt(keep), sqrt(1.0 - keep)
    p *= root
    R *= root
    R[0, 0] = max(R[0, 0], BASE)
    state[HEAD + 3 * n + n * n : HEAD + 3 * n + 3 * n * n] *= keep * keep
    state[HEAD + 3 * n + 3 * n * n : HEAD + 3 * n + 5 * n * n] *= keep
    state[WEIGHT] *= keep
    pull[:] = 0.0
    for j in range(1, n):
        pull[j] = leak
        rotate_in(R, p, pull, leak * x[j], j)


@njit(cache=True, error_model="numpy")
def compare(state: Array, n: int, z: Array) -> None:
    """Take the increments of one step into N and L: z (n,) holds dT in place of the constant, then the columns' ones.

    In units of the torque noise: per step, not per row.
    """
    before, N, L = state[HEAD + 2 * n : HEAD + 3 * n], matrix(state, n, 3), matrix(state, n, 4)
    for i in range(n):
        for j in range(n):
            N[i, j] += z[i] * z[j]
            L[i, j] += z[i] * before[j] + before[i] * z[j]
    before[:] = z
    state[WEIGHT] += 1.0


@njit(cache=True, error_model="numpy")
def interrupt(state: Array, n: int) -> None:
    """The next increment has no neighbour before it."""
    state[HEAD + 2 * n : HEAD + 3 * n] = 0.0


@njit(cache=True, error_model="numpy")
def take(state: Array, n: int, row: Array, y: float) -> None:
    """Take the newest row' x = y and solve; `row` (n,), its constant first, is overwritten."""
    x, p, R, V = state[HEAD : HEAD + n], state[HEAD + n : HEAD + 2 * n], factor(state, n), matrix(state, n, 2)
    for i in range(n):
        for j in range(n):
            V[i, j] += row[i] * row[j]
    rotate_in(R, p, row, y, 0)
    solve_triangular(R, p, x)
    state[TAKEN] += 1.0


@njit(cache=True, error_model="numpy")
def _misfit(x: Array, N: Array) -> float:
    """Of the unknowns x (n,), whose place 0 the torque takes with the weight -1, in products N (n, n)."""
    total = N[0, 0]
    for i in range(1, x.size):
        total -= 2.0 * x[i] * N[0, i]
        for j in range(1, x.size):
            total += x[i] * N[i, j] * x[j]
    return total


@njit(cache=True, error_model="numpy")
def noise(state: Array, n: int, declared: float) -> tuple[float, float]:
    """Variances of an increment's error in units of the declared torque noise: r^2, and what the next one takes back.

    declared  the second of them, as far as it was declared: it counts as much as one increment, as r^2 = 1 does
    """
    x, weight = state[HEAD : HEAD + n], state[WEIGHT]
    apart = _misfit(x, matrix(state, n, 4))
    taken_back = (PRIOR_WEIGHT * declared + max(-apart, 0.0)) / (PRIOR_WEIGHT + weight)
    if weight == 0.0:
        return 1.0, taken_back
    unexplained = max(_misfit(x, matrix(state, n, 3)) - taken_back * weight, 0.0) / weight
    # Where torque noise drowns in the rest, the declared one stands, unless what is found is clear by 4 deviations.
    clear = max(unexplained - CLEAR * sqrt(2.0 / weight) * taken_back, 1.0)
    told = weight * (clear / (clear + taken_back)) ** 2
    return (PRIOR_WEIGHT + told * unexplained) / (PRIOR_WEIGHT + told), taken_back


@njit(cache=True, error_model="numpy")
def variance(state: Array, n: int, slope: Array, torque: float, velocity: float, work: Array) -> float:
    """Variance of slope' x, slope (n,) with slope_0 = 0.

    torque    r^2, as `noise` has it
    velocity  variance of the velocity noise's share of a row
    work      (n,) overwritten
    """
    R, M, V = factor(state, n), matrix(state, n, 1), matrix(state, n, 2)
    solve_transposed(R, slope, work)
    solve_triangular(R, work, work)
    total = 0.0
    for i in range(n):
        if i > 0:
            total += work[i] * work[i]  # the prior, and what has leaked since
        for j in range(n):
            total += work[i] * (torque * M[i, j] + velocity * V[i, j]) * work[j]
    return max(total, 0.0)
