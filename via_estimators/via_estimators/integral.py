"""Least squares on the integrated motor equation, with standard deviations that account for coloured noise.

Source: SAPHARI deliverable, eqs. (36)-(49), as corrected: integrated from a base t_0 up to t,

    B thd(t) + D theta(t) - sum_j a_j I_j(t) + c = T(t),   I_j = integral f_j(phi),   T = integral tau

with the minus missing in (39) and the constant c = -B thd(t_0) - D theta(t_0) missing in (36), an unknown here. The
motor's acceleration does not occur.

**Moving base.** Integrals from a fixed base grow without bound. Moving the base by the increments dI, dT (angles are
counted from now on, dtheta) adds multiples of the constant's column to the others,

    row' = row S,  S = 1 + e_0 s',   s = (0, 0, -dtheta, dI_1, ..),   y' = y - dT row_0

so with the constant in column 0 only row 0 of the triangular factor R changes: R_0j += R_00 s_j, p_0 -= R_00 dT. The
information is exactly preserved, and the newest row is always (1, thd, 0, .., 0) with y = 0. Where the motion stops or
the record has a gap, a new constant begins: dropping row 0 of R eliminates the old one exactly.

**Noise.** White torque noise e_n of variance r^2 is a random walk in T, so the errors of neighbouring rows are
correlated and (R'R)^-1 is far too small. Relative to the moving base, the newest row has no error, and each step adds
-dt e_n to every older one. With the weighted sum of rows v = R_00 R_0, which is known, the gradient's covariance obeys

    M <- lambda^2 (S'MS + dt^2 (S'v)(S'v)'),   Cov(x) = P (r^2 M + prior) P,   P = (R'R)^-1

exactly. Filtered noise is coloured, with correlations r_d of e_n and e_(n-d). Where r_d = C A^(d-1) B, as for the
output of a small linear filter, the covariance U of the gradient's error with the noise to come is a further state: the
sum over d of (A^(d-1) B) (the step of d samples ago, relative to the present base)', and

    M <- .. + dt (S'v (CU) + (CU)' v'S) + (r_0 - 1) dt^2 (S'v)(S'v)',   U <- A U + dt B v'S

is exact again; white noise is r_0 = 1 alone. White noise on the velocity sensor enters row by row, V <- lambda^2 S'VS +
F F'. Both are measured on increments of the equation: torque noise is white there, and velocity noise v enters
successive increments with opposite signs, B (v_n - v_(n-1)). N sums products of increments, L those of neighbours, so
that misfit and correlation refer to the present unknowns: x'Lx gives the velocity noise, x'Nx + x'Lx the torque noise
r^2. Smoothed signals have no such noise: V, N and L exist only where the torque noise is white.

Unknowns are scaled, x_j = (a_j - prior_j) / prior_sd_j, except for the constant, so that the prior is a unit matrix.
Each step adds a pull towards the present estimate of the weight it forgets (a leak, proximal): P <= 1, and without
excitation standard deviations grow back to those of the prior. Errors of the angles are included only so far as they
resemble torque noise; noise on phi and theta also biases estimates towards 0, which no covariance includes.

**Truncation.** Columns of terms that are not solved for follow the n unknowns: rotations place them beside R as R_c.
Since R x = p and R x* + R_c t = p, the error of the estimate is R^-1 R_c t for coefficients t (Schmidt's 'considered'
parameters). That holds for the data as visited and includes the effect on B and D.
"""

from __future__ import annotations

from math import sqrt

from numba import njit
from via_core.signals import Array

from via_estimators.qr import NEGLIGIBLE, invert_triangular, reflect_in, rotate_in, solve_triangular
from via_estimators.slots import slots

# Sum of the weights of increments; rows taken; columns considered; states of the noise's colour; factor yet to forget.
HEAD = slots("weight", "taken", "cut", "poles", "pending")
PRIOR_WEIGHT = 1.0  # weight of the declared noise, in increments
CLEAR = 4.0  # [standard deviations] of r^2 in velocity noise, sqrt(2 / W) of the variance of W increments
BASE = 1e-12  # R_00 without any row: the constant has no prior


@njit(cache=True, error_model="numpy")
def size(n: int, cut: int, poles: int) -> int:
    """Numbers in the state of one equation with n unknowns, including the constant, and `cut` columns considered."""
    return HEAD.size + 2 * n + _sums(poles) * n * n + n * cut + n * poles + n * (n + cut + 1)


@njit(cache=True, error_model="numpy")
def _sums(poles: int) -> int:
    """Number of the matrices M, V, N and L in the state."""
    return 4 if poles == 0 else 1


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int, cut: int, poles: int) -> None:
    """Overwrite one equation's state with the prior: x = 0, R = 1 except for the constant, no rows."""
    state[:] = 0.0
    state[HEAD.cut], state[HEAD.poles], state[HEAD.pending] = cut, poles, 1.0
    R = factor(state, n)
    R[0, 0] = BASE
    for j in range(1, n):
        R[j, j] = 1.0


@njit(cache=True, error_model="numpy")
def unknowns(state: Array, n: int) -> Array:
    """The view x (n,), the constant first."""
    return state[HEAD.size : HEAD.size + n]


@njit(cache=True, error_model="numpy")
def _before(state: Array, n: int) -> Array:
    """The view (n,) of the last increments."""
    return state[HEAD.size + n : HEAD.size + 2 * n]


@njit(cache=True, error_model="numpy")
def _matrices(state: Array, n: int) -> Array:
    """The view (4, n, n) of M, V, N and L, or (1, n, n) of M alone if noise is coloured."""
    at, count = HEAD.size + 2 * n, _sums(int(state[HEAD.poles]))
    return state[at : at + count * n * n].reshape(count, n, n)


@njit(cache=True, error_model="numpy")
def considered(state: Array, n: int) -> Array:
    """The view R^-1 R_c (cut, n), the error of x per unit coefficient of the columns considered."""
    at = HEAD.size + 2 * n + _sums(int(state[HEAD.poles])) * n * n
    cut = int(state[HEAD.cut])
    return state[at : at + cut * n].reshape(cut, n)


@njit(cache=True, error_model="numpy")
def _shared(state: Array, n: int) -> Array:
    """The view U (poles, n)."""
    poles = int(state[HEAD.poles])
    at = HEAD.size + 2 * n + _sums(poles) * n * n + int(state[HEAD.cut]) * n
    return state[at : at + poles * n].reshape(poles, n)


@njit(cache=True, error_model="numpy")
def _right(state: Array, n: int) -> Array:
    """The view p (n,), stored before R."""
    at = state.size - n * (n + int(state[HEAD.cut]) + 1)
    return state[at : at + n]


@njit(cache=True, error_model="numpy")
def factor(state: Array, n: int) -> Array:
    """The view (n, n + cut) of R (n, n), triangular, with R_c (n, cut) beside it."""
    width = n + int(state[HEAD.cut])
    return state[state.size - n * width :].reshape(n, width)


@njit(cache=True, error_model="numpy")
def _move(M: Array, s: Array) -> None:
    """M (n, n) <- S'MS with S = 1 + e_0 s', s_0 = 0; s (n,) or longer."""
    n = M.shape[0]
    corner = M[0, 0]
    for i in range(1, n):
        beside = M[i, 0] + corner * s[i]
        for j in range(1, n):
            M[i, j] += s[i] * M[0, j] + beside * s[j]
    for i in range(1, n):
        M[0, i] += corner * s[i]
        M[i, 0] = M[0, i]


@njit(cache=True, error_model="numpy")
def rebase(state: Array, n: int, s: Array, pushed: float, step: float, colour: Array, work: Array) -> None:
    """Move the base of all rows to the present.

    s       (n + cut,) added to each column per unit of the constant's column, s_0 = 0
    pushed  dT, the integral of the torque over the step, in the units of y
    step    [s] its duration over the unit of torque noise: the error of dT per unit noise
    colour  (1 + poles, 1 + poles) of that noise, [[r_0, C], [B, A]]; [[1]] if it is white
    work    (2, n) or more, overwritten
    """
    p, R, sums = _right(state, n), factor(state, n), _matrices(state, n)
    M, base = sums[0], R[0, 0]
    for j in range(1, s.size):
        R[0, j] += base * s[j]
    p[0] -= base * pushed
    for which in range(min(len(sums), 2)):  # M, and V if present
        _move(sums[which], s)
    U, poles = _shared(state, n), int(state[HEAD.poles])
    v, along = work[0], work[1]
    for j in range(n):
        v[j] = step * base * R[0, j]
        along[j] = 0.5 * colour[0, 0] * v[j]
    for c in range(poles):
        for j in range(1, n):
            U[c, j] += s[j] * U[c, 0]
        for j in range(n):
            along[j] += colour[0, 1 + c] * U[c, j]
    for i in range(n):
        for j in range(n):
            M[i, j] += v[i] * along[j] + along[i] * v[j]
    for j in range(n):
        for c in range(poles):
            along[c] = colour[1 + c, 0] * v[j]
            for b in range(poles):
                along[c] += colour[1 + c, 1 + b] * U[b, j]
        for c in range(poles):
            U[c, j] = along[c]


@njit(cache=True, error_model="numpy")
def eliminate(state: Array, n: int) -> None:
    """Eliminate the constant, since later rows have another one; information on the other unknowns is preserved."""
    p, R, sums = _right(state, n), factor(state, n), _matrices(state, n)
    for which in range(min(len(sums), 2)):
        M = sums[which]
        for i in range(1, n):  # G M G', G = (-R_0j / R_00, 1)
            for j in range(1, n):
                a, b = R[0, i] / R[0, 0], R[0, j] / R[0, 0]
                M[i, j] += a * b * M[0, 0] - a * M[0, j] - b * M[i, 0]
        M[0, :] = 0.0
        M[:, 0] = 0.0
    U = _shared(state, n)
    for c in range(U.shape[0]):
        for i in range(1, n):
            U[c, i] -= R[0, i] / R[0, 0] * U[c, 0]
        U[c, 0] = 0.0
    R[0, :] = 0.0
    R[0, 0] = BASE
    p[0] = 0.0
    state[HEAD.size] = 0.0
    considered(state, n)[:, 0] = 0.0


@njit(cache=True, error_model="numpy")
def forget(state: Array, n: int, keep: float, work: Array) -> None:
    """One step of forgetting by the factor lambda = keep, in the usual meaning, with the leak of the same weight.

    Steps that forget very little are accumulated to save reflections (`qr.NEGLIGIBLE`).

    work  (n + cut + 1, n) or more, overwritten
    """
    keep *= state[HEAD.pending]
    if keep > 1.0 - NEGLIGIBLE:
        state[HEAD.pending] = keep
        return
    state[HEAD.pending] = 1.0
    x, p, R, off = unknowns(state, n), _right(state, n), factor(state, n), considered(state, n)
    poles, at, each = int(state[HEAD.poles]), HEAD.size + 2 * n, n * n
    root, leak = sqrt(keep), sqrt(1.0 - keep)
    state[state.size - n * (R.shape[1] + 1) :] *= root  # p and R
    R[0, 0] = max(R[0, 0], BASE)
    if poles == 0:
        state[at : at + 2 * each] *= keep * keep  # M and V
        state[at + 2 * each : at + 4 * each] *= keep  # N and L
    else:
        state[at : at + each] *= keep * keep
        at += each + off.size
        state[at : at + poles * n] *= keep  # U
    state[HEAD.weight] *= keep
    cut, y = off.shape[0], work[n + off.shape[0], : n - 1]
    for j in range(1, n):
        for i in range(n - 1):
            work[j, i] = 0.0
        work[j, j - 1] = leak
        y[j - 1] = leak * x[j]
        for c in range(cut):  # the target of the leak has the same truncation error
            work[n + c, j - 1] = leak * off[c, j]
    reflect_in(R, p, work, y, 1)


@njit(cache=True, error_model="numpy")
def compare(state: Array, n: int, z: Array) -> None:
    """Add the increments z (n,) of one step to N and L; z_0 is dT, the others are those of the columns.

    In units of the torque noise per step.
    """
    before, sums = _before(state, n), _matrices(state, n)
    N, L = sums[2], sums[3]
    for i in range(n):
        for j in range(n):
            N[i, j] += z[i] * z[j]
            L[i, j] += z[i] * before[j] + before[i] * z[j]
    before[:] = z
    state[HEAD.weight] += 1.0


@njit(cache=True, error_model="numpy")
def interrupt(state: Array, n: int) -> None:
    """Clear the correlations of the next increment with earlier ones."""
    _before(state, n)[:] = 0.0
    _shared(state, n)[:, :] = 0.0


@njit(cache=True, error_model="numpy")
def take(state: Array, n: int, row: Array, y: float) -> None:
    """Add the newest row' x = y and solve; `row` (n + cut,), its constant first, is overwritten."""
    x, p, R = unknowns(state, n), _right(state, n), factor(state, n)
    if state[HEAD.poles] == 0.0:
        V = _matrices(state, n)[1]
        for i in range(n):
            for j in range(n):
                V[i, j] += row[i] * row[j]
    rotate_in(R, p, row, y, 0)
    solve_triangular(R, p[:n], x)
    off = considered(state, n)
    for c in range(off.shape[0]):
        for j in range(n):
            off[c, j] = R[j, n + c]
        solve_triangular(R, off[c], off[c])
    state[HEAD.taken] += 1.0


@njit(cache=True, error_model="numpy")
def _misfit(x: Array, N: Array) -> float:
    """z' N z of z = (-1, x_1, ..), N (n, n)."""
    total = N[0, 0]
    for i in range(1, x.size):
        total -= 2.0 * x[i] * N[0, i]
        for j in range(1, x.size):
            total += x[i] * N[i, j] * x[j]
    return total


@njit(cache=True, error_model="numpy")
def noise(state: Array, n: int, declared: float) -> tuple[float, float]:
    """Variances in units of the declared torque noise: r^2, and that of velocity noise in one increment.

    declared  prior of the second, with the weight of one increment, as r^2 = 1 has
    """
    x, weight, sums = unknowns(state, n), state[HEAD.weight], _matrices(state, n)
    apart = _misfit(x, sums[3])
    taken_back = (PRIOR_WEIGHT * declared + max(-apart, 0.0)) / (PRIOR_WEIGHT + weight)
    if weight == 0.0:
        return 1.0, taken_back
    unexplained = max(_misfit(x, sums[2]) - taken_back * weight, 0.0) / weight
    # Where velocity noise dominates, the declared torque noise is used unless the measured one is significant.
    clear = max(unexplained - CLEAR * sqrt(2.0 / weight) * taken_back, 1.0)
    informative = weight * (clear / (clear + taken_back)) ** 2
    return (PRIOR_WEIGHT + informative * unexplained) / (PRIOR_WEIGHT + informative), taken_back


@njit(cache=True, error_model="numpy")
def inverse(state: Array, n: int, out: Array) -> None:
    """R^-1 into the first n rows and columns of `out`, for `prior_variance` and `variances`."""
    invert_triangular(factor(state, n), n, out)


@njit(cache=True, error_model="numpy")
def prior_variance(state: Array, n: int, first: int, inverted: Array) -> float:
    """Variance of the unknowns from `first` on about their prior, in units of the declared one, as estimated from them.

    Each unknown determined by data is one draw from the prior; their number is the sum of (1 - P_jj), MacKay's number
    of well-determined parameters. The declared variance has the weight of one.

    inverted  R^-1 of `inverse`
    """
    x = unknowns(state, n)
    drawn, squares = PRIOR_WEIGHT, PRIOR_WEIGHT
    for j in range(first, n):
        drawn += 1.0
        for i in range(j, n):
            drawn -= inverted[j, i] * inverted[j, i]
        squares += x[j] * x[j]
    return squares / drawn


@njit(cache=True, error_model="numpy")
def variances(
    state: Array, n: int, slopes: Array, torque: float, velocity: float, prior: Array, inverted: Array, work: Array,
    out: Array,
) -> None:  # fmt: skip
    """Variances of slope' x for each of slopes (k, n), whose first column is 0, into out (k,).

    torque    r^2 of `noise`
    velocity  variance of the velocity noise in a row; 0 if torque noise is coloured
    prior     (n,) variances of the prior and the leak
    inverted  R^-1 of `inverse`
    work      (n + 2, n) or more, overwritten
    """
    sums, half, full, middle = _matrices(state, n), work[0], work[1], work[2:]  # R^-T slope, P slope
    for i in range(n):  # covariance of the right side due to noise and prior, lower half
        for j in range(i + 1):
            middle[i, j] = torque * sums[0, i, j]
        if velocity > 0.0:
            for j in range(i + 1):
                middle[i, j] += velocity * sums[1, i, j]
        middle[i, i] += prior[i] if i > 0 else 0.0
    for k in range(slopes.shape[0]):
        half[:n] = 0.0
        for i in range(n):
            if slopes[k, i] != 0.0:
                for j in range(i, n):
                    half[j] += inverted[i, j] * slopes[k, i]
        found = 0.0
        for i in range(n):
            along = 0.0
            for j in range(i, n):
                along += inverted[i, j] * half[j]
            full[i] = along
            total = 0.0
            for j in range(i):
                total += middle[i, j] * full[j]
            found += along * (2.0 * total + middle[i, i] * along)
        out[k] = max(found, 0.0)
