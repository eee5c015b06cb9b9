"""Least squares for unknowns that may change: Kalman filters of different assumptions, mixed by their likelihood.

Source: H. A. P. Blom, Y. Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching
coefficients, IEEE Transactions on Automatic Control 33(8), 1988.

The unknowns x (n,) contain the spring laws of m transmissions. Law i changes along a direction g_i (n,), which the
caller renews: if g_i is the present law, its scale s_i changes. The last m unknowns are the trends ds_i/dt. Each of the
K models assumes one way of changing (CHANGES): none, a random walk of the scales, a random walk of their trends, which
decay with time constant PERSISTENCE, or a jump since the last equations. All springs may change by one cause, or one
alone: walks of the s_i have the covariance C = (I + 1 1') m / (m + 1), by which a unit change of either kind has the
same probability as one standard deviation of a single spring.

Equations arrive at their times, one of each channel,

    y = row' x + e,    variance of e = level within + beside + wobbling_j sum_ik C_ik (row' g_i) (row' g_k)

where wobbling_j is the variance by which a scale of model j changes within the equation's window.

A filter alone cannot distinguish noise that is larger than declared from a spring that changes: both explain large
innovations, and only their course shows which. So the level of a channel's noise is unknown, one of LEVELS, and each
model has its own probabilities w_l of it. A step of time dt is

    1. interaction   with probability 1 - e, e = exp(-dt / memory), another model holds, j with probability rho_j. After
                     a jump another model holds at once, j with probability rho_j: c_j = own_j + after_j + (1 - e) rho_j,
                     own_j = e mu_j (jump: 0),  after_j = e mu_jump rho_j. x_j, P_j and w become those of the mixture of
                     x_j, x_jump and the combined estimate with weights own_j, after_j, (1 - e) rho_j
    2. prediction    s walks by walk_j^2 dt, or the trend by trend_j^2 dt; a jump adds JUMP^2 = walk_j^2 dt
    3. correction    once per equation, with v = y - row' x_j and S_l = row' P_j row + variance at level l
                     w_l <- w_l N(v; S_l) / likelihood,   mu_j <- mu_j likelihood,   likelihood = sum_l w_l N(v; S_l)
                     The gains P row / S_l of the levels are averaged, and P_j is the covariance of their mixture
    4. combination   mean and covariance of the mixture of models

Since the model after a change does not depend on the one before, step 1 mixes each filter with the combined estimate
and a jump only, and a step costs K n^2. The rho of the model without change is `steadiness`, the rest share
1 - steadiness. A filter without change that missed one has lost its probability and is thereby set to the estimate of
those that followed. That is the innovation test of this method: it has no limit to choose.

**An equation that may fail.** The last channel may have a block of unknowns of its own and a hypothesis that it does
not hold: a force of variance `force` acts, or its unknowns changed. Then the equation is not used, and its unknowns
return to their prior. It begins to fail with probability 1 - e and goes on with probability LASTING; likelihood and
correction are mixed by it like the levels. Level l > 1 of this channel means that something else than noise disturbs
it, which lasts for `slow` equations: its excess counts so many times more in the gain than in the likelihood.

**Noise of its coefficients.** Where y = 0 and noise of variance within = x' Sigma x enters through the row, least
squares would make x smaller to reduce the noise. The expected noise of the row given v, -Sigma x v / S, is therefore
removed from it: row <- row + v / S Sigma x, with `noisy` = Sigma x / within. After convergence these are the rows of
total least squares (S. Van Huffel, J. Vandewalle, The Total Least Squares Problem, SIAM 1991), whose residual belongs
to the row.

Unknowns are scaled so that the prior is x = 0, P = 1, but for the trends, which are 0 before any data.
"""

from __future__ import annotations

from collections import namedtuple
from math import exp, inf, log

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators.noise_levels import LEVELS, NEVER, NOISES, of_level, weigh
from via_estimators.slots import slots

# Random walk of the scale [1/sqrt(s)] and of its trend [1/s/sqrt(s)].
CHANGES = (
    (0.0, 0.0),
    (0.01, 0.0),
    (0.1, 0.0),
    (0.0, 0.003),
    (0.0, 0.03),
    (0.0, 0.1),
    (0.0, 0.2),
    (0.0, 0.45),
    (0.0, 1.0),
    (0.0, 3.0),
    (0.0, 10.0),
    (0.0, 0.0),
)
WALKS = tuple(walk for walk, _ in CHANGES)
TRENDS = tuple(trend for _, trend in CHANGES)
MODELS, JUMPING = len(CHANGES), len(CHANGES) - 1  # the last is the jump
JUMP = 0.5  # standard deviation of the scale in a jump
# [spans], [spans^3] variance of <w, w_55> of a walk w of rate 1 from the middle of the window, and of its integral
WOBBLE, BENDING = 0.034, 0.00031
PERSISTENCE = 2.0  # [s] in which a trend decays to 1/e
FURTHEST = 1.0  # variance of the scale that time alone can add
LASTING = 0.5  # probability that an equation that failed fails again
NEGLIGIBLE = 0.01  # probability of failing that is not mixed: its wide prior would let the unknowns walk
HEAD = slots("taken", "time", "changing")  # times of equations; the last one [s]; probability of a change
# Views of the state: HEAD; probability of the models (K,), of failing (K,), of the levels (K, channels, LEVELS); means
# (K + 1, n) and covariances (K + 1, n, n), the last ones combined.
Bank = namedtuple("Bank", ("head", "probability", "fails", "levels", "x", "P"))
# Work space: (n,) three times; likelihoods (LEVELS,); wobbling_j (K,); sum C_ik g_i g_k' (n, n).
Work = namedtuple("Work", ("before", "there", "gain", "likely", "wobbling", "along"))


@njit(cache=True, error_model="numpy")
def size(n: int, channels: int) -> int:
    """Floats in the state."""
    return HEAD.size + MODELS * (2 + channels * LEVELS) + (MODELS + 1) * (n + n * n)


@njit(cache=True, error_model="numpy")
def bank_of(state: Array, n: int, channels: int) -> Bank:
    """The views of a state (size,)."""
    a = HEAD.size + 2 * MODELS
    b = a + MODELS * channels * LEVELS
    c = b + (MODELS + 1) * n
    return Bank(
        state[: HEAD.size],
        state[HEAD.size : HEAD.size + MODELS],
        state[HEAD.size + MODELS : a],
        state[a:b].reshape(MODELS, channels, LEVELS),
        state[b:c].reshape(MODELS + 1, n),
        state[c : c + (MODELS + 1) * n * n].reshape(MODELS + 1, n, n),
    )


@njit(cache=True, error_model="numpy")
def scratch(n: int) -> Work:
    """Work space, allocated once since allocations are slow."""
    return Work(np.empty(n), np.empty(n), np.empty(n), np.empty(LEVELS), np.zeros(MODELS), np.zeros((n, n)))


@njit(cache=True, error_model="numpy")
def _of_prior(j: int, steadiness: float) -> float:
    """rho_j."""
    return steadiness if j == 0 else max((1.0 - steadiness) / (MODELS - 1), NEVER)


@njit(cache=True, error_model="numpy", inline="always")
def _shared(i: int, k: int, m: int) -> float:
    """C_ik."""
    return (2.0 if i == k else 1.0) * m / (m + 1.0)


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int, m: int, channels: int, steadiness: float) -> None:
    """Overwrite the state with the prior of n unknowns, the last m of them trends; `steadiness` as in `begin`."""
    state[:] = 0.0
    bank = bank_of(state, n, channels)
    for c in range(channels):
        for k in range(LEVELS):
            bank.levels[:, c, k] = of_level(c, channels, k)
    for j in range(MODELS + 1):
        if j < MODELS:
            bank.probability[j] = _of_prior(j, steadiness)
        for i in range(n - m):
            bank.P[j, i, i] = 1.0


@njit(cache=True, error_model="numpy")
def quadratic(P: Array, v: Array) -> float:
    """v' P v of P (n, n), v (n,), at least 0."""
    total = 0.0
    for i in range(v.size):
        row = 0.0
        for j in range(v.size):
            row += P[i, j] * v[j]
        total += v[i] * row
    return max(total, 0.0)


@njit(cache=True, error_model="numpy")
def wander(bank: Bank, age: float) -> float:
    """Variance of a scale that the walks of the models add in `age` [s] after the last equations."""
    total = 0.0
    for j in range(MODELS):
        total += bank.probability[j] * (WALKS[j] ** 2 * age + TRENDS[j] ** 2 * age**3 / 3.0)
    return min(total, FURTHEST)


@njit(cache=True, error_model="numpy")
def _interact(bank: Bank, m: int, stay: float, steadiness: float, work: Work) -> None:
    """Step 1; c_j replaces the probabilities of the models."""
    n, landed = bank.x.shape[1], bank.probability[JUMPING]
    mean, covariance, before, there = bank.x[MODELS], bank.P[MODELS], work.before, work.there
    levels, fails = np.zeros(bank.levels.shape[1:]), 0.0
    for j in range(MODELS):
        levels += bank.probability[j] * bank.levels[j]
        fails += bank.probability[j] * bank.fails[j]
    for j in range(MODELS):  # the jump last, since all read it
        x, P, rho = bank.x[j], bank.P[j], _of_prior(j, steadiness)
        own, after = stay * bank.probability[j] if j < JUMPING else 0.0, stay * landed * rho
        c = max(own + after + (1.0 - stay) * rho, NEVER)
        bank.probability[j] = c
        own, after = own / c, after / c
        rest = 1.0 - own - after
        for i in range(n):
            moved = own * x[i] + after * bank.x[JUMPING, i] + rest * mean[i]
            before[i], there[i] = x[i] - moved, bank.x[JUMPING, i] - moved
            x[i] = moved
        for i in range(n):
            a, b, d = own * before[i], after * there[i], rest * (mean[i] - x[i])
            for k in range(n):
                P[i, k] = (
                    own * P[i, k] + after * bank.P[JUMPING, i, k] + rest * covariance[i, k]
                    + a * before[k] + b * there[k] + d * (mean[k] - x[k])
                )  # fmt: skip
        if TRENDS[j] == 0.0:  # what this model does not assume
            x[n - m :] = 0.0
            P[n - m :, :], P[:, n - m :] = 0.0, 0.0
        mixed = own * bank.levels[j] + after * bank.levels[JUMPING] + rest * levels
        for c in range(mixed.shape[0]):
            for k in range(LEVELS):
                bank.levels[j, c, k] = stay * mixed[c, k] + (1.0 - stay) * of_level(c, mixed.shape[0], k)
        failed = own * bank.fails[j] + after * bank.fails[JUMPING] + rest * fails
        bank.fails[j] = failed * LASTING + (1.0 - failed) * (1.0 - stay)


@njit(cache=True, error_model="numpy")
def _predict(x: Array, P: Array, g: Array, elapsed: float, added: float, trend: float, along: Array) -> None:
    """Step 2: x <- F x, P <- F P F' + Q, F = [[1, moved g], [0, keep]]; `added` variance of s, `trend` squared rate."""
    n, m = x.size, g.shape[0]
    last = n - m
    if trend > 0.0:
        keep = exp(-elapsed / PERSISTENCE)
        steady = min(elapsed, PERSISTENCE, (3.0 * FURTHEST / trend) ** (1.0 / 3.0))  # over which the trend walks
        moved = PERSISTENCE * (1.0 - keep)
        for i in range(m):
            t = last + i
            for a in range(last):
                if g[i, a] != 0.0:
                    x[a] += moved * g[i, a] * x[t]
                    for b in range(n):
                        P[a, b] += moved * g[i, a] * P[t, b]
        for a in range(n):
            for i in range(m):
                rate = moved * P[a, last + i]
                for b in range(last):
                    P[a, b] += rate * g[i, b]
        x[last:] *= keep
        P[last:, :] *= keep
        P[:, last:] *= keep
        for i in range(m):
            for k in range(m):
                shared = _shared(i, k, m)
                P[last + i, last + k] += shared * trend * steady
                for a in range(last):
                    half = 0.5 * shared * trend * steady**2 * g[i, a]
                    P[a, last + k] += half
                    P[last + k, a] += half
        added = trend * steady**3 / 3.0
    if added > 0.0:
        for a in range(last):
            for b in range(last):
                P[a, b] += added * along[a, b]


@njit(cache=True, error_model="numpy")
def begin(
    bank: Bank, time: float, memory: float, steadiness: float, g: Array, span: float, work: Work
) -> None:  # fmt: skip
    """Steps 1 and 2 to `time` [s].

    memory      [s] mean time between changes of the model
    steadiness  prior probability that no spring changes
    g           (m, n) change of x per unit of each scale, 0 at the trends
    span        [s] of an equation's window, to which x belongs in its middle
    """
    m, n = g.shape
    elapsed = max(time - bank.head[HEAD.time], 0.0) if bank.head[HEAD.taken] > 0.0 else 0.0
    _interact(bank, m, exp(-elapsed / memory), steadiness, work)
    work.along[:] = 0.0
    for i in range(m):
        for k in range(m):
            shared = _shared(i, k, m)
            for a in range(n):
                for b in range(n):
                    work.along[a, b] += shared * g[i, a] * g[k, b]
    for j in range(MODELS):
        walk, added = WALKS[j] ** 2, min(WALKS[j] ** 2 * elapsed, FURTHEST)
        if j == JUMPING:
            walk, added = JUMP**2 / max(elapsed, WOBBLE * span, NEVER), JUMP**2
        work.wobbling[j] = WOBBLE * span * walk + BENDING * span**3 * TRENDS[j] ** 2
        _predict(bank.x[j], bank.P[j], g, elapsed, added, TRENDS[j] ** 2, work.along)
    bank.head[HEAD.taken] += 1.0
    bank.head[HEAD.time] = time


@njit(cache=True, error_model="numpy", inline="always")
def _times(P: Array, row: Array, out: Array) -> None:
    """P row into out (n,), for a symmetric P and a row with zeros."""
    out[:] = 0.0
    for k in range(row.size):
        if row[k] != 0.0:
            for i in range(row.size):
                out[i] += row[k] * P[k, i]


@njit(cache=True, error_model="numpy")
def _mix(
    x: Array, P: Array, gain: Array, step: float, shrink: float, failed: float, own: tuple[int, int], change: Array
) -> None:  # fmt: skip
    """Correct x by gain step and P by shrink gain gain'; with probability `failed` reset the unknowns `own` instead.

    change  (n,) overwritten: the estimate if the equation holds, less that if it fails
    """
    n, holds = x.size, 1.0 - failed
    if failed == 0.0:
        for a in range(n):
            x[a] += step * gain[a]
            scaled = shrink * gain[a]
            for b in range(n):
                P[a, b] -= scaled * gain[b]
        return
    for a in range(n):
        mine = own[0] <= a < own[1]
        change[a] = step * gain[a] + (x[a] if mine else 0.0)
        x[a] = holds * change[a] + (0.0 if mine else x[a])
        for b in range(n):
            corrected = P[a, b] - shrink * gain[a] * gain[b]
            reset = (1.0 if a == b else 0.0) if mine or own[0] <= b < own[1] else P[a, b]
            P[a, b] = holds * corrected + failed * reset
    for a in range(n):
        apart = failed * holds * change[a]
        for b in range(n):
            P[a, b] += apart * change[b]


@njit(cache=True, error_model="numpy")
def take(
    bank: Bank, channel: int, row: Array, y: float, within: float, beside: float, noisy: Array, slow: float,
    force: float, own: tuple[int, int], work: Work,
) -> None:  # fmt: skip
    """Step 3 with the equation row' x = y of a channel; rows and y in any units, noise in those of y.

    within, beside  variance of y: as declared, and the part that is not noise
    noisy           (n,) Sigma x / within; zeros where the row has no noise
    slow            equations over which excess noise lasts, less 1
    force           variance of what makes the equation fail; 0: it cannot
    own             first unknown of this equation alone, and the one after the last
    """
    n, gain, highest = row.size, work.gain, -inf
    for j in range(MODELS):
        x, P, weights = bank.x[j], bank.P[j], bank.levels[j, channel]
        _times(P, row, gain)
        v, doubt, known = y, 0.0, beside
        for i in range(n):
            v -= row[i] * x[i]
            doubt += row[i] * gain[i]
        if work.wobbling[j] > 0.0:
            known += work.wobbling[j] * quadratic(work.along, row)
        failing = bank.fails[j] if force > 0.0 else 0.0
        fit, failed = weigh(v, max(doubt, 0.0) + known, within, force, weights, failing, work.likely)
        bank.probability[j] = log(max(bank.probability[j], NEVER)) + fit
        highest = max(highest, bank.probability[j])
        of_row = 0.0  # the share of v that is noise of the row
        for k in range(LEVELS):
            of_row += weights[k] * min(NOISES[k], 1.0) * within / (max(doubt, 0.0) + known + NOISES[k] * within)
        for i in range(n):
            work.before[i] = row[i] + v * of_row * noisy[i]
        _times(P, work.before, gain)
        doubt = 0.0
        for i in range(n):
            doubt += work.before[i] * gain[i]
        inverse = square = 0.0
        for k in range(LEVELS):
            excess = slow * max(NOISES[k] - 1.0, 0.0) * within
            S = max(doubt, 0.0) + known + NOISES[k] * within + excess
            inverse += weights[k] / S
            square += weights[k] / (S * S)
        shrink = inverse - v * v * max(square - inverse * inverse, 0.0)
        if force > 0.0:
            bank.fails[j] = failed
        _mix(x, P, gain, inverse * v, shrink, failed if failed > NEGLIGIBLE else 0.0, own, work.there)
    total = 0.0
    for j in range(MODELS):
        bank.probability[j] = exp(bank.probability[j] - highest)
        total += bank.probability[j]
    bank.probability[:] /= total


@njit(cache=True, error_model="numpy")
def combine(bank: Bank) -> None:
    """Step 4."""
    n, mean, covariance = bank.x.shape[1], bank.x[MODELS], bank.P[MODELS]
    mean[:], covariance[:, :] = 0.0, 0.0
    for j in range(MODELS):
        for i in range(n):
            mean[i] += bank.probability[j] * bank.x[j, i]
    for j in range(MODELS):
        x, P, mu = bank.x[j], bank.P[j], bank.probability[j]
        for i in range(n):
            apart = mu * (x[i] - mean[i])
            for k in range(n):
                covariance[i, k] += mu * P[i, k] + apart * (x[k] - mean[k])
    for i in range(n):
        for k in range(i):
            covariance[i, k] = covariance[k, i] = 0.5 * (covariance[i, k] + covariance[k, i])
    bank.head[HEAD.changing] = 1.0 - bank.probability[0]
