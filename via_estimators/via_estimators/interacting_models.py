"""Least squares for unknowns that may change: Kalman filters of different assumptions, mixed by their likelihood.

Source: H. A. P. Blom, Y. Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching
coefficients, IEEE Transactions on Automatic Control 33(8), 1988.

The unknowns x from `first` to n - 2 change along one direction g, which the caller renews. If g is the present
spring law, its scale s changes. The last unknown is the trend of that change, ds/dt. Each of the K models assumes
a noise level and one way of changing (CHANGES): none, a random walk of s, a random walk of the trend, which decays
with time constant PERSISTENCE, a random walk of friction, or a jump of s since the last equation; or no change and
coloured noise. In the last models x is constant and y, the measured quantity, has a wrong scale 1 + c: c walks, or has
jumped since the last equation. c is an unknown, and 0 in all other models. Equations arrive one at a time,

    y = row' x + e,    variance of e = noise_j within + beside
                                       + wobble (walk_j^2 (row' g)^2 + wear_j^2 |row_f|^2 + gain_j^2 row_c^2)

with row_f the entries of row that belong to friction and row_c that of c.

One step of time dt with one equation is

    1. interaction   with probability 1 - e, e = exp(-dt / memory), another model holds, j with probability rho_j. After
                     a jump another model holds at once, at the same noise level l and with the same assumption on c:
                     p_j = own_j + after_j + (1 - e) rho_j,  own_j = e mu_j (jumps: 0),  after_j = e mu_jump(l) L rho_j
                     over the sum of these rho,
                     x_j <- mean of x_j, x_jump(l) and the combined mean with weights own_j, after_j, (1 - e) rho_j,
                     P_j <- covariance of that mixture
    2. prediction    s walks by walk_j^2 dt, or the trend by trend_j^2 dt; a jump adds JUMP^2 = walk_j^2 dt;
                     P_j += g g' times that variance, and SHAPE^2 |g|^2 of it in each direction;
                     each unknown of friction walks by wear_j^2 dt, c by gain_j^2 dt; a jump of y's scale makes
                     it 0 +- JUMP
    3. correction    S_j = row' P_j row + variance of e, and Kalman's gain in Joseph's form
    4. probability   mu_j ~ p_j S_j^(-1/2) exp(-(y - row' x_j)^2 / (2 S_j))
    5. combination   mean and covariance of the mixture

Since the model after a change does not depend on the one before, step 1 mixes each filter with the combined estimate
and a jump only, and a step costs K n^2. The rho of models without change sum to `steadiness`, the rest share
1 - steadiness. A filter without change that missed one has lost its probability and is thereby set to the estimate of
those that followed. That is the innovation test of this method: it has no limit to choose.

A walk or a jump may also change the shape, as when a motor moves the preset of the spring: a part SHAPE^2 g' g of its
variance is in every direction. A trend, which has a long memory, keeps the shape.

Grease that warms up changes damping and dry friction within minutes, a touched motor within one equation. Neither is a
change of the spring. Without these models the spring would explain it: where damping is most of a motor's torque, a
tenth less of it made a stiffness wrong by half.

A drive that warms up, or whose gain is switched, reports torques of another scale; then all of x seems to change in
proportion. A spring that changes leaves the rest of x as it was: the inertia, which never changes, and what excites
damping and friction decide between the two. c is the scale over that at the start, so x keeps its scale. Models that
know nothing of c have c = 0 exactly: with c free in all of them, the scale would be as uncertain as the first
equations, and constant springs had errors of 2 % in place of .1 %. After a jump of c its models are the only ones,
since one Gaussian for both kinds of jump lies between them and fits neither.

Noise levels are part of the hypotheses, since a filter alone cannot distinguish noise that is larger than declared from
a spring that changes: both explain large innovations v, and only their course shows which. Between its neighbours each
model finds its noise as the mean of noise + (v^2 - S) / within, weighted by (noise within / S)^2, the inverse of that
number's variance.

Coloured noise is a stationary process of correlation time CORRELATION (Gauss-Markov) beside the white noise declared.
Its model therefore takes each equation less r = exp(-dt / CORRELATION) times the one before: the process has the
variance 1 - r^2 of its level then and is white (Cochrane and Orcutt, Journal of the American Statistical Association
44, 1949), and white noise has 1 + r^2 of its variance. Noise has a colour if an effect is missing in the equation.
Without this model a changing spring would explain it.

Such an effect depends on the state of the joint and returns with its motion, so it does not average out. A disturbance
of a given mean square that lies in m directions instead of N has N / m of the squared projection on each of them. With
m = n - 1 unknowns, which are what N equations can distinguish, its part of the variance is N / (n - 1) times that of
independent noise (`returning`).

One equation's state is a flat row; `size` and the slots below define its layout. Unknowns are scaled so that the prior
is x = 0, P = 1, but for the trend and c, which are 0 before any data.
"""

from __future__ import annotations

from math import exp, inf, log

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import gaussians
from via_estimators.slots import slots

# Random walk of the scale [1/sqrt(s)], of its trend [1/s/sqrt(s)], of every unknown of friction and of the scale of y
# [1/sqrt(s)]; first no change, in white and in coloured noise, last the jumps.
JUMP = 0.5  # standard deviation of a scale in a jump
CHANGES = (
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0),
    (0.01, 0.0, 0.0, 0.0),
    (0.1, 0.0, 0.0, 0.0),
    (0.0, 0.003, 0.0, 0.0),
    (0.0, 0.03, 0.0, 0.0),
    (0.0, 0.3, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 5.0, 0.0, 0.0),
    (0.0, 0.0, 0.03, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 0.003),
    (0.0, 0.0, 0.0, 0.03),
    (JUMP, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, JUMP),
)
SHAPE = 0.08  # standard deviation of each unknown in a walk or jump, over that of the scale times the length of g
LEVELS = (0.0316, 0.1, 0.316, 1.0, 3.16, 10.0, 31.6)  # of noise, over the declared standard deviation
HALF_STEP = 10.0**0.5  # variance between a level and the middle to its neighbour
WALKS, TRENDS, WEARS, GAINS = (tuple(change[at] for change in CHANGES for _ in LEVELS) for at in range(4))
NOISES = tuple(level**2 for _ in CHANGES for level in LEVELS)
MODELS = len(NOISES)
PERSISTENCE = 2.0  # [s] in which a trend decays to 1/e
CORRELATION = 0.2  # [s] in which coloured noise does
WHITE = len(LEVELS)  # the models of white noise without change come first, then those of coloured noise
COLOURED = 2 * len(LEVELS)  # end of these
FURTHEST = 1.0  # variance of the scale that time alone can add
JUMPING = MODELS - 2 * len(LEVELS)  # the first model of a jump, of x; those of the scale of y follow
RESCALED = sum(change[3] > 0.0 for change in CHANGES)  # number of changes of the scale of y
SCALED = 0.045  # probability that a change is one of y's scale: joints are built to change their springs
NEVER = 1e-300  # probability of a model that is excluded
KNOWN = 1.0  # weight of a model's noise level, in equations
LEAST_NOISE = 1e-12  # of the declared variance
# Equations taken; time of the last one [s]; probability of anything but white noise without change.
HEAD = slots("taken", "time", "disturbed")
MODEL = slots("probability", "noise", "weight")  # rows (K,) that follow: noise in units of the declared variance


@njit(cache=True, error_model="numpy")
def size(n: int) -> int:
    """Floats in the state of one equation: HEAD, MODEL, combined mean and covariance, x and P of each model, row, y."""
    return HEAD.size + MODEL.size * MODELS + (MODELS + 1) * (n + n * n) + n + 1


@njit(cache=True, error_model="numpy")
def _of_prior(j: int, steadiness: float) -> float:
    """rho_j."""
    if j < WHITE:
        return steadiness / WHITE
    scaled = RESCALED * len(LEVELS)
    share = SCALED / scaled if GAINS[j] > 0.0 else (1.0 - SCALED) / (MODELS - WHITE - scaled)
    return max((1.0 - steadiness) * share, NEVER)


@njit(cache=True, error_model="numpy")
def start(state: Array, n: int, scale: int, steadiness: float) -> None:
    """Overwrite one equation's state with the prior; `scale` and `steadiness` as in `take`."""
    state[:] = 0.0
    models = models_of(state)
    models[MODEL.weight] = KNOWN
    for j in range(MODELS):
        models[MODEL.probability, j], models[MODEL.noise, j] = _of_prior(j, steadiness), NOISES[j]
    for j in range(MODELS + 1):
        P = _block(state, n, j)[1]
        for i in range(n - 1):
            P[i, i] = 0.0 if i == scale else 1.0


@njit(cache=True, error_model="numpy", inline="always")
def models_of(state: Array) -> Array:
    """The view (3, K) of MODEL."""
    return state[HEAD.size : HEAD.size + MODEL.size * MODELS].reshape(MODEL.size, MODELS)


@njit(cache=True, error_model="numpy", inline="always")
def _block(state: Array, n: int, j: int) -> tuple[Array, Array]:
    """The views x (n,) and P (n, n), of the combined estimate for j = 0, of model j - 1 for the others."""
    at = HEAD.size + MODEL.size * MODELS + j * (n + n * n)
    return state[at : at + n], state[at + n : at + n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy", inline="always")
def estimate_of(state: Array, n: int) -> tuple[Array, Array]:
    """The views mean (n,) and covariance (n, n) of the combined estimate at the time of the last equation."""
    return _block(state, n, 0)


def condition(state: Array, n: int, scale: int) -> float:
    """Condition number of the combined covariance, without the trend and the scale of y, which may be known."""
    unknown = np.delete(np.arange(n - 1), scale)
    return float(np.linalg.cond(estimate_of(state, n)[1][np.ix_(unknown, unknown)]))


@njit(cache=True, error_model="numpy")
def wander(state: Array, age: float) -> float:
    """Variance of the scale that the walks of the models add in `age` [s] after the last equation."""
    total, probability = 0.0, models_of(state)[MODEL.probability]
    for j in range(JUMPING):
        total += probability[j] * (WALKS[j] ** 2 * age + TRENDS[j] ** 2 * age**3 / 3.0)
    return min(total, FURTHEST)


@njit(cache=True, error_model="numpy")
def elapsed(state: Array, time: float) -> float:
    """Time [s] since the last equation, 0 before the first."""
    return max(time - state[HEAD.time], 0.0) if state[HEAD.taken] > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def innovation_of(
    state: Array, n: int, row: Array, y: float, passed: float, g: Array, within: float
) -> tuple[float, float, float]:  # fmt: skip
    """Innovation of y by the combined estimate, `passed` [s] later; its variance but for `beside`; what a jump adds."""
    mean, covariance = estimate_of(state, n)
    models, level, innovation, along = models_of(state), 0.0, y, 0.0
    for j in range(MODELS):
        level += models[MODEL.probability, j] * models[MODEL.noise, j]
    for i in range(n):
        innovation -= row[i] * mean[i]
        along += row[i] * g[i]
    doubt = gaussians.quadratic(covariance, row) + wander(state, passed) * along * along
    return innovation, doubt + level * within, (JUMP * along) ** 2


@njit(cache=True, error_model="numpy")
def returning(state: Array, n: int) -> float:
    """Variance that an effect missing in the equation adds, over that of independent noise; ~0 if noise is white."""
    models, total = models_of(state), 0.0
    for j in range(WHITE, COLOURED):
        total += models[MODEL.probability, j] * models[MODEL.weight, j]
    return total / (n - 1)


@njit(cache=True, error_model="numpy")
def scratch(n: int) -> Array:
    """Work space of `take`, allocated once since allocations are slow."""
    width = max(n, MODELS)
    return np.empty((6 + (n * n - 1) // width + 1, width))


@njit(cache=True, error_model="numpy")
def _interact(
    state: Array, n: int, scale: int, stay: float, steadiness: float, probable: Array, there: Array, P: Array
) -> None:  # fmt: skip
    """Step 1; p_j into `probable` (K,); `there` (n,) and P (n, n) are overwritten."""
    probability = models_of(state)[MODEL.probability]
    mean, covariance = estimate_of(state, n)
    off = RESCALED * len(LEVELS) * _of_prior(MODELS - 1, steadiness)
    for level in range(len(LEVELS)):
        for group in range(2):
            jump = JUMPING + group * len(LEVELS) + level
            landed = stay * probability[jump] * len(LEVELS) / (off if group else 1.0 - off)
            arrived = max(1.0 - stay + landed, NEVER)
            there[:], P[:, :] = mean, covariance
            x, cover = _block(state, n, jump + 1)
            gaussians.mix(there, P, landed / arrived, x, cover)
            for j in range(level, MODELS, len(LEVELS)):
                if (GAINS[j] > 0.0) != group:
                    continue
                x, cover = _block(state, n, j + 1)
                own, new = stay * probability[j] if j < JUMPING else 0.0, arrived * _of_prior(j, steadiness)
                probable[j] = max(own + new, NEVER)
                gaussians.mix(x, cover, 1.0 - own / probable[j], there, P)
                if TRENDS[j] == 0.0:  # what this model does not assume
                    x[n - 1] = 0.0
                    cover[n - 1, :] = cover[:, n - 1] = 0.0
                if not group:
                    x[scale] = 0.0
                    cover[scale, :] = cover[:, scale] = 0.0


@njit(cache=True, error_model="numpy")
def _predict(x: Array, P: Array, g: Array, first: int, elapsed: float, added: float, trend: float) -> None:
    """Step 2: x <- F x, P <- F P F' + Q, F = [[1, moved g], [0, keep]]; `added` variance of s, `trend` squared rate."""
    last, free = x.size - 1, 0.0
    if trend == added == 0.0:
        return
    if trend > 0.0:
        keep = exp(-elapsed / PERSISTENCE)
        steady = min(elapsed, PERSISTENCE, (3.0 * FURTHEST / trend) ** (1.0 / 3.0))  # over which the trend walks
        moved = PERSISTENCE * (1.0 - keep)
        rate = P[last, last]
        for i in range(last):
            x[i] += moved * g[i] * x[last]
            for k in range(last):
                P[i, k] += moved * (g[i] * P[last, k] + P[i, last] * g[k]) + moved * moved * rate * g[i] * g[k]
        for i in range(last):
            P[i, last] = keep * (P[i, last] + moved * rate * g[i]) + 0.5 * trend * steady**2 * g[i]
            P[last, i] = P[i, last]
        x[last] *= keep
        P[last, last] = keep * keep * rate + trend * steady
        added = trend * steady**3 / 3.0
    else:
        for i in range(first, last):
            free += SHAPE**2 * added * g[i] * g[i]
    for i in range(first, last):
        for k in range(first, last):
            P[i, k] += added * g[i] * g[k]
        P[i, i] += free


@njit(cache=True, error_model="numpy")
def _combine(state: Array, n: int) -> None:
    """Step 5."""
    probability = models_of(state)[MODEL.probability]
    mean, covariance = estimate_of(state, n)
    mean[:], covariance[:, :] = 0.0, 0.0
    for j in range(MODELS):
        x = _block(state, n, j + 1)[0]
        for i in range(n):
            mean[i] += probability[j] * x[i]
    for j in range(MODELS):
        x, P = _block(state, n, j + 1)
        for i in range(n):
            for k in range(n):
                covariance[i, k] += probability[j] * (P[i, k] + (x[i] - mean[i]) * (x[k] - mean[k]))


@njit(cache=True, error_model="numpy")
def take(
    state: Array, n: int, time: float, memory: float, steadiness: float, g: Array, first: int, friction: Array,
    scale: int, row: Array, y: float, within: float, beside: float, wobble: float, work: Array,
) -> None:  # fmt: skip
    """One step to `time` [s] with the equation row' x = y; time, rows and y in any units, noise in those of y.

    memory          [s] mean time between changes of the model
    steadiness      prior probability that x does not change
    g, first        (n,) change of x per unit of the scale, 0 before `first` and in the end
    friction        (n,) 1 for the unknowns of friction, 0 for the others
    scale           the unknown that is the relative change of the scale of y
    within, beside  variance of y: per unit of noise, and the known part
    wobble          [s] variance, over the equation's window, of a random walk of rate 1 about its middle
    work            `scratch`
    """
    ahead, probable, likely, fresh = work[0, :n], work[2], work[3], work[5, :n]
    models, passed = models_of(state), elapsed(state, time)
    stay = exp(-passed / memory)
    _interact(state, n, scale, stay, steadiness, probable, work[4, :n], work[6:].reshape(-1)[: n * n].reshape(n, n))
    along, rubbing, highest, total = 0.0, 0.0, -inf, 0.0
    last = state[state.size - n - 1 :]
    again = exp(-passed / CORRELATION) if passed > 0.0 else 0.0
    for i in range(n):
        along += row[i] * g[i]
        rubbing += friction[i] * row[i] * row[i]
        fresh[i], last[i] = row[i] - again * last[i], row[i]
    fresh_y, last[n] = y - again * last[n], y
    for j in range(MODELS):
        x, P = _block(state, n, j + 1)
        walk, wear, gained, noise = WALKS[j] ** 2, WEARS[j] ** 2, GAINS[j] ** 2, models[MODEL.noise, j]
        lasted, rate = (passed, 1.0) if j < JUMPING else (1.0, 1.0 / max(passed, wobble, NEVER))
        if j >= JUMPING and gained > 0.0:
            x[scale], P[scale, :], P[:, scale] = 0.0, 0.0, 0.0
        _predict(x, P, g, first, passed, min(walk * lasted, FURTHEST), TRENDS[j] ** 2)
        for i in range(n):
            P[i, i] += friction[i] * min(wear * lasted, FURTHEST)
        P[scale, scale] += min(gained * lasted, FURTHEST)
        coloured = WHITE <= j < COLOURED
        own = fresh if coloured else row
        innovation, doubt = fresh_y if coloured else y, 0.0
        unit = (1.0 - again * again) * within if coloured else within
        known = (1.0 + again * again) * (beside + within) if coloured else beside
        gaussians.times(P, own, ahead)
        for i in range(n):
            innovation -= own[i] * x[i]
            doubt += own[i] * ahead[i]
        moved = walk * along * along + wear * rubbing + gained * row[scale] ** 2
        error = noise * unit + known + wobble * rate * moved
        variance = max(doubt, 0.0) + error
        likely[j] = log(probable[j]) - 0.5 * (innovation * innovation / variance + log(variance))
        highest = max(highest, likely[j])
        share = (noise * unit / variance) ** 2
        models[MODEL.weight, j] = KNOWN + stay * (models[MODEL.weight, j] - KNOWN) + share
        noise += (innovation * innovation - variance) / unit * share / models[MODEL.weight, j]
        low = NOISES[j] / HALF_STEP if NOISES[j] > NOISES[0] else LEAST_NOISE
        models[MODEL.noise, j] = min(max(noise, low), NOISES[j] * HALF_STEP if NOISES[j] < NOISES[-1] else inf)
        gaussians.correct(x, P, own, innovation, variance, error, ahead, work[1, :n])
    for j in range(MODELS):
        models[MODEL.probability, j] = exp(likely[j] - highest)
        total += models[MODEL.probability, j]
    models[MODEL.probability] /= total
    state[HEAD.taken] += 1.0
    state[HEAD.time] = time
    state[HEAD.disturbed] = models[MODEL.probability, WHITE:].sum()
    _combine(state, n)
