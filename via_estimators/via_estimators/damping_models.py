"""Dissipation torque of a damper under hypotheses on its polynomial, its friction and its changes: a bank of filters.

The torque of one window, with mean velocity m of variance S^2 inside the window and mean acceleration a, is modelled as

    tau = w_1 m + w_2 <v^3>/s^2 + w_3 <v^5>/s^4 + F <sgn v> + E <sgn v exp(-(v/b)^2)> + c - t dtau/dt

with F Coulomb friction, E the excess of breakaway friction (Stribeck), c the offset of the torque sensor and t its
delay. The velocity b and the number n of powers are unknown, so each structure (n, b) is a hypothesis with its own
values of all unknowns, and each of CHANGES a hypothesis on how fast w_1 changes. One Kalman filter per pair:

    interaction   among the filters of one structure, as in `interacting_models`; a structure keeps its own unknowns
    correction    S_j = row' P_j row + variance of noise; noise is found by each filter from its innovations
    probability   mu_j ~ c_j S_j^(-1/2) exp(-e^2 / (2 S_j))
    combination   mean and covariance of the mixture of all: Bayesian model averaging

Sources: J. A. Hoeting et al., Bayesian model averaging: a tutorial, Statistical Science 14(4), 1999; A. E. Raftery, M.
Karny, P. Ettler, Online prediction under model uncertainty via dynamic model averaging, Technometrics 52(1), 2010, for
probabilities that may change; H. A. P. Blom, Y. Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988.

The covariance of the mixture includes the disagreement of the hypotheses, and so the error of a polynomial cut off too
early. Unknowns are scaled so that the prior is x = 0, P = 1; those that a structure lacks have P = 0 and remain 0.
"""

from __future__ import annotations

from math import erf, exp, inf, log, sqrt

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators.interacting_models import FURTHEST, KNOWN, LEAST_NOISE, NEVER, PERSISTENCE
from via_estimators.slots import slots

U = slots("linear", "cubic", "quintic", "coulomb", "stribeck", "between", "offset", "late", "trend")  # unknowns
POWERS = 3
STRIBECK = (0.02, 0.029, 0.042, 0.061, 0.089, 0.13, 0.19, 0.27, 0.4, 0.58)  # [rad/s] velocities b; besides, none
HALF_STEP = 1.2  # from a velocity to the middle to its neighbour
NONE = 0.3  # prior probability of friction without Stribeck effect
OF_POWERS = (0.5, 0.3, 0.2)  # prior probabilities of n = 1, 2, 3
SHAPES = len(STRIBECK) + 1
STRUCTURES = POWERS * SHAPES
# Random walk of w_1 [1/sqrt(s)] and of its trend [1/s/sqrt(s)], in prior standard deviations; the last one follows a
# damper that is switched.
CHANGES = ((0.0, 0.0), (0.03, 0.0), (0.3, 0.0), (0.0, 0.1), (0.0, 1.0), (3.0, 0.0))
OF_CHANGES = (0.799, 0.08, 0.02, 0.08, 0.02, 0.001)
RATES = len(CHANGES)
FILTERS = STRUCTURES * RATES
DRIFT = 0.003  # random walk of every other unknown [prior standard deviations/sqrt(s)]
REVISION = 60.0  # [s] mean time between changes of the structure
NEGLIGIBLE = 1e-12  # probability without effect on the covariance
HEAD = slots("taken", "time")  # equations taken; time of the last one [s]
FILTER = slots("probability", "noise", "weight")  # rows (FILTERS,) that follow


@njit(cache=True, error_model="numpy")
def size() -> int:
    """Floats in the state: HEAD, FILTER, combined mean and covariance, then x and P of each filter."""
    n = U.size
    return HEAD.size + FILTER.size * FILTERS + (FILTERS + 1) * (n + n * n)


@njit(cache=True, error_model="numpy", inline="always")
def _filters(state: Array) -> Array:
    """The view (3, FILTERS) of FILTER."""
    return state[HEAD.size : HEAD.size + FILTER.size * FILTERS].reshape(FILTER.size, FILTERS)


@njit(cache=True, error_model="numpy", inline="always")
def estimate_of(state: Array) -> tuple[Array, Array]:
    """The views mean (n,) and covariance (n, n) of the combined estimate at the time of the last equation."""
    n, at = U.size, HEAD.size + FILTER.size * FILTERS
    return state[at : at + n], state[at + n : at + n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy", inline="always")
def _unknowns(state: Array) -> tuple[Array, Array]:
    """The views x (FILTERS, n) and P (FILTERS, n, n)."""
    n = U.size
    at = HEAD.size + FILTER.size * FILTERS + n + n * n
    split = at + n * FILTERS
    return state[at:split].reshape(FILTERS, n), state[split : split + n * n * FILTERS].reshape(FILTERS, n, n)


@njit(cache=True, error_model="numpy")
def _of_structure(structure: int) -> float:
    """Prior probability."""
    powers, shape = structure // SHAPES, structure % SHAPES
    return OF_POWERS[powers] * (NONE if shape == 0 else (1.0 - NONE) / (SHAPES - 1))


@njit(cache=True, error_model="numpy")
def _has(structure: int, j: int) -> bool:
    """Whether a structure has the unknown j (the trend aside)."""
    if j == U.cubic or j == U.quintic:
        return j <= structure // SHAPES
    return (j != U.stribeck and j != U.between) or structure % SHAPES > 0


@njit(cache=True, error_model="numpy")
def start(state: Array) -> None:
    """Overwrite with the prior."""
    state[:] = 0.0
    filters = _filters(state)
    P = _unknowns(state)[1]
    filters[FILTER.weight], filters[FILTER.noise] = KNOWN, 1.0
    for j in range(FILTERS):
        structure = j // RATES
        filters[FILTER.probability, j] = _of_structure(structure) * OF_CHANGES[j % RATES]
        for i in range(U.trend):
            P[j, i, i] = 1.0 if _has(structure, i) else 0.0
    combine(state)


@njit(cache=True, error_model="numpy")
def combine(state: Array) -> None:
    """Mean and covariance of the mixture."""
    n, probability = U.size, _filters(state)[FILTER.probability]
    mean, covariance = estimate_of(state)
    x, P = _unknowns(state)
    mean[:], covariance[:, :] = 0.0, 0.0
    for j in range(FILTERS):
        for i in range(n):
            mean[i] += probability[j] * x[j, i]
    for j in range(FILTERS):
        if probability[j] < NEGLIGIBLE:
            continue
        for i in range(n):
            off = x[j, i] - mean[i]
            for k in range(n):
                covariance[i, k] += probability[j] * (P[j, i, k] + off * (x[j, k] - mean[k]))


@njit(cache=True, error_model="numpy")
def relax(state: Array, keep: float) -> None:
    """Without equations, covariances approach the prior's: P <- keep P + (1 - keep) prior; trends fade."""
    x, P = _unknowns(state)
    P *= keep
    for j in range(FILTERS):
        x[j, U.trend] *= keep
        for i in range(U.trend):
            if _has(j // RATES, i):
                P[j, i, i] += 1.0 - keep
    combine(state)


@njit(cache=True, error_model="numpy")
def wander(state: Array, age: float) -> float:
    """Variance of x_1 that the walks of the hypotheses add in `age` [s] after the last equation."""
    total, probability = 0.0, _filters(state)[FILTER.probability]
    for j in range(FILTERS):
        if probability[j] < NEGLIGIBLE:
            continue
        walk, trend = CHANGES[j % RATES]
        total += probability[j] * (walk**2 * age + trend**2 * age**3 / 3.0)
    return min(total, 1.0)


@njit(cache=True, error_model="numpy")
def _stribeck(mean: float, square: float, b: float) -> float:
    """Mean of sgn v exp(-(v/b)^2) over velocities N(mean, square); in closed form, a product of two Gaussians."""
    half = 0.5 * b * b
    narrow = half / (half + square)  # of the variance
    return sqrt(narrow) * exp(-0.5 * mean * mean / (half + square)) * erf(mean * sqrt(narrow / (2.0 * square)))


@njit(cache=True, error_model="numpy")
def shapes(mean: float, square: float, out: Array) -> None:
    """Regressors of friction over velocities N(mean, square), for each kind, into out (SHAPES, 2).

    Mean of the shape, sgn v for Coulomb friction and sgn v exp(-(v/b)^2) for each b; half the difference of its means
    for the velocities halfway to the neighbours of b, by which a velocity between those of the list is interpolated.
    """
    out[0, 0], out[0, 1] = erf(mean / sqrt(2.0 * square)), 0.0
    for k in range(len(STRIBECK)):
        b = STRIBECK[k]
        out[k + 1, 0] = _stribeck(mean, square, b)
        out[k + 1, 1] = 0.5 * (_stribeck(mean, square, b * HALF_STEP) - _stribeck(mean, square, b / HALF_STEP))


@njit(cache=True, error_model="numpy")
def scratch() -> Array:
    """Work space of `take`, allocated once since allocations are slow."""
    return np.empty(4 * U.size + U.size * U.size + FILTERS)


@njit(cache=True, error_model="numpy", inline="always")
def _mix(
    x: Array, P: Array, own: Array, stay: float, share: float, first: int, probable: Array, mean: Array, M: Array
) -> None:
    """Interaction of the filters of one structure, x (RATES, n), P (RATES, n, n), of probabilities own (RATES,).

    probable  (FILTERS,) from `first` on: c_j
    mean, M   (n,), (n, n) overwritten with mean and covariance of the structure
    """
    n, whole = mean.size, 0.0
    for j in range(RATES):
        whole += own[j]
    mean[:], M[:, :] = 0.0, 0.0
    for j in range(RATES):
        part = own[j] / whole
        for i in range(n):
            mean[i] += part * x[j, i]
    for j in range(RATES):
        part = own[j] / whole
        for i in range(n):
            off = x[j, i] - mean[i]
            for k in range(n):
                M[i, k] += part * (P[j, i, k] + off * (x[j, k] - mean[k]))
    for j in range(RATES):
        held = stay * own[j] / whole
        now = held + (1.0 - stay) * OF_CHANGES[j]
        probable[first + j] = share * now
        held /= now
        other = 1.0 - held
        for i in range(n):
            off = held * other * (x[j, i] - mean[i])
            for k in range(n):
                P[j, i, k] = held * P[j, i, k] + other * M[i, k] + off * (x[j, k] - mean[k])
        for i in range(n):
            x[j, i] = held * x[j, i] + other * mean[i]
        if CHANGES[j][1] == 0.0:  # what this filter does not assume
            x[j, U.trend] = 0.0
            for k in range(n):
                P[j, U.trend, k] = P[j, k, U.trend] = 0.0


@njit(cache=True, error_model="numpy", inline="always")
def _predict(x: Array, P: Array, elapsed: float, walk: float, trend: float) -> None:
    """x <- F x, P <- F P F' + Q, x (n,), P (n, n): the trend moves x_1 and decays; `walk`, `trend`: squared rates."""
    n, at = x.size, U.trend
    if trend > 0.0:
        keep = exp(-elapsed / PERSISTENCE)
        moved = PERSISTENCE * (1.0 - keep)
        steady = min(elapsed, PERSISTENCE, (3.0 * FURTHEST / trend) ** (1.0 / 3.0))  # over which the trend walks
        x[0] += moved * x[at]
        x[at] *= keep
        for k in range(n):
            P[0, k] += moved * P[at, k]
        for k in range(n):
            P[k, 0] += moved * P[k, at]
        for k in range(n):
            P[at, k] *= keep
        for k in range(n):
            P[k, at] *= keep
        P[at, at] += trend * steady
        P[0, at] += 0.5 * trend * steady**2
        P[at, 0] += 0.5 * trend * steady**2
        P[0, 0] += trend * steady**3 / 3.0
    P[0, 0] += min(walk * elapsed, FURTHEST)


@njit(cache=True, error_model="numpy")
def _friction(state: Array, scales: Array) -> tuple[float, float]:
    """Mean [N m] and mean square of breakaway friction, that of the mixture.

    A variance of each structure's own would change their likelihoods.
    """
    mean, covariance = estimate_of(state)
    c, s = U.coulomb, U.stribeck
    middle = scales[c] * mean[c] + scales[s] * mean[s]
    variance = scales[c] ** 2 * covariance[c, c] + scales[s] ** 2 * covariance[s, s]
    return middle, max(middle * middle + variance + 2.0 * scales[c] * scales[s] * covariance[c, s], 0.0)


@njit(cache=True, error_model="numpy")
def late(state: Array, scales: Array, prior: float, mean: float, acceleration: float, square: float) -> float:
    """Regressor of the torque's delay [N m/s]: the rate at which the torque of the present estimate falls.

    prior  [N m s/rad] damping that x = 0 stands for

    The rate of friction is that over one standard deviation of the delay, since it may change its sign within it.
    """
    damping = prior + scales[U.linear] * estimate_of(state)[0][U.linear]
    step = scales[U.late]
    if step <= 0.0:
        return 0.0
    before = erf((mean - step * acceleration) / sqrt(2.0 * square))
    change = (erf(mean / sqrt(2.0 * square)) - before) / step
    return -damping * acceleration - _friction(state, scales)[0] * change


@njit(cache=True, error_model="numpy")
def take(
    state: Array, time: float, memory: float, scales: Array, v: Array, shape: Array, y: float, noise: float, work: Array
) -> None:
    """One step to `time` [s] with an equation.

    memory  [s] mean time between changes of the rate of change
    scales  (n,) prior standard deviations of the unknowns
    v       (n,) regressors of all but friction
    shape   (SHAPES, 2) as `shapes` left it
    y       [N m] torque less that of the prior
    noise   [(N m)^2] declared variance of y
    work    `scratch`
    """
    n, filters = U.size, _filters(state)
    mean, row, gain = work[:n], work[n : 2 * n], work[2 * n : 3 * n]
    M = work[4 * n : 4 * n + n * n].reshape(n, n)
    probable = work[4 * n + n * n :]
    x, P = _unknowns(state)
    probability, noises, weights = filters[FILTER.probability], filters[FILTER.noise], filters[FILTER.weight]
    elapsed = max(time - state[HEAD.time], 0.0) if state[HEAD.taken] > 0.0 else 0.0
    stay, revised = exp(-elapsed / memory), exp(-elapsed / REVISION)
    drift, highest = DRIFT**2 * elapsed, -inf
    for i in range(n):
        row[i] = v[i] * scales[i]
    row[U.coulomb], row[U.trend] = shape[0, 0] * scales[U.coulomb], 0.0
    # Where motion reverses within the window, or the joint sticks, the mean of friction is uncertain.
    beside = (1.0 - shape[0, 0] ** 2) * _friction(state, scales)[1]
    for structure in range(STRUCTURES):
        first, kind = structure * RATES, structure % SHAPES
        whole = 0.0
        for j in range(first, first + RATES):
            whole += probability[j]
        share = revised * whole + (1.0 - revised) * _of_structure(structure)
        last = first + RATES
        _mix(x[first:last], P[first:last], probability[first:last], stay, share, first, probable, mean, M)
        row[U.stribeck] = row[U.between] = 0.0
        if kind > 0:
            row[U.stribeck], row[U.between] = shape[kind, 0] * scales[U.stribeck], shape[kind, 1] * scales[U.between]
        for j in range(first, last):
            walk, trend = CHANGES[j - first]
            _predict(x[j], P[j], elapsed, walk**2, trend**2)
            innovation, doubt = y, 0.0
            for i in range(1, U.trend):
                if _has(structure, i):
                    P[j, i, i] += drift
            for i in range(n):
                total = 0.0
                for k in range(n):
                    total += P[j, i, k] * row[k]
                gain[i] = total
                innovation -= row[i] * x[j, i]
                doubt += row[i] * total
            variance = max(doubt, 0.0) + noises[j] * noise + beside
            probable[j] = log(max(probable[j], NEVER)) - 0.5 * (innovation * innovation / variance + log(variance))
            highest = max(highest, probable[j])
            part = (noises[j] * noise / variance) ** 2
            weights[j] = KNOWN + stay * (weights[j] - KNOWN) + part
            noises[j] += (innovation * innovation - variance) / noise * part / weights[j]
            noises[j] = max(noises[j], LEAST_NOISE)
            for i in range(n):
                along = gain[i] / variance
                x[j, i] += along * innovation
                for k in range(n):
                    P[j, i, k] -= along * gain[k]
    total = 0.0
    for j in range(FILTERS):
        probability[j] = exp(probable[j] - highest)
        total += probability[j]
    for j in range(FILTERS):
        probability[j] = max(probability[j] / total, NEVER)
    state[HEAD.taken] += 1.0
    state[HEAD.time] = time
    combine(state)
