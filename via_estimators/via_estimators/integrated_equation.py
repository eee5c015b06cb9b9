"""The integrated motor equation of one transmission in a basis of its spring law, with the basis' truncation error.

Shared by `signal_based` and `filtered_signal_based`, which feed it with measured and with smoothed signals; `integral`
contains the recursion. The unknowns are the constant of integration, B, D and the spring coefficients.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Any

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import integral, transmissions, window
from via_estimators.basis import (
    BASES,
    LEGENDRE,
    MOST_TERMS,
    ODD_LEGENDRE,
    POWERS,
    fill_basis,
    swing_before,
    swing_of_last,
)
from via_estimators.slots import row_of, slots
from via_estimators.transmissions import VISITED
from via_estimators.window import HEADER

# Followed by the means (n,) and the standard deviations (n,) of the prior, 0 for the constant.
P = slots(
    "length", "transmissions", "basis", "terms", "memory", "max_gap", "sampling", "torque_noise", "velocity_noise",
    "position_noise", "deflection_scale", "minimum_motion", "range_margin", "horizon", "truncation",
)  # fmt: skip
# Of each transmission, before its equation: whether integrals run, their duration [s], velocity and angle of the motor
# in the last sample, followed by the basis (terms + omitted,) there.
KEPT = slots("running", "age", "velocity", "angle", after=VISITED)
E = slots("stiffness", "slope", "inertia", "damping", "variances")  # variances (3,) of stiffness, inertia, damping
N_ESTIMATE = E.size + 2
FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
CLEAR = 4.0  # [standard deviations] a coefficient as large as that needs no prior
LEGENDRE_AT_0 = (1.0, -0.5, 0.375, -0.3125)  # P_0, P_2, P_4, P_6
# By degree n > 2: power of c_n c_(n-4) / c_(n-2)^2 by which c_(n+2) / c_n is smaller than c_n / c_(n-2); see `fall`.
BENDING = (0.0, 0.0, 0.0, *(log((n + 2.0) / n) / log(n / (n - 2.0)) for n in range(3, 2 * MOST_TERMS)))
ROUNDS = 5  # iterations for the first omitted coefficient; each at least halves the error


def parameter_row(parameters: Any, **given: float) -> Array:
    """The row of slots P and of the prior; `given` replaces attributes of the parameters."""
    mean, width = transmissions.prior_rows(parameters, parameters.terms)
    row = row_of(P, parameters, length=parameters.window + 1, basis=BASES[parameters.basis], **given)
    return np.concatenate([row, [0.0], mean, [0.0], width])


def initial_state(parameters: Any, others: int, extra: int, poles: int) -> Array:
    """The locked state before any data: header, prior, `others` zeros (rings, filters), one part per transmission.

    extra  further numbers per transmission, before its equation
    poles  states of the noise's autocorrelation, see `integral.rebase`
    """
    m, terms, cut = parameters.transmissions, parameters.terms, omitted(BASES[parameters.basis])
    prior, size = transmissions.prior_outputs(parameters, "inertia", "damping"), integral.size(terms + 3, cut, poles)
    each = KEPT.size + terms + cut + extra + size
    state = np.zeros(HEADER.size + len(prior) + others + m * each)
    window.start(state)
    state[HEADER.size : HEADER.size + len(prior)] = prior
    for part in state[len(state) - m * each :].reshape(m, each):
        integral.start(part[each - size :], terms + 3, cut, poles)
    state.flags.writeable = False
    return state


def condition(parameters: Any, state: Array, extra: int, poles: int) -> float:
    """Largest condition number [-] of the equations in a state, without their constants."""
    m, n, cut = parameters.transmissions, parameters.terms + 3, omitted(BASES[parameters.basis])
    size = integral.size(n, cut, poles)
    each = KEPT.size + parameters.terms + cut + extra + size
    parts = state[len(state) - m * each :].reshape(m, each)
    factors = [integral.factor(part[each - size :], n) for part in parts]
    return max(float(np.linalg.cond(R[1:n, 1:n])) for R in factors)


@njit(cache=True, error_model="numpy")
def row_unit(par: Array) -> float:
    """Unit of the rows [N m s]: torque noise integrated over one window."""
    return par[P.torque_noise] * par[P.sampling] * sqrt(par[P.length] - 1.0)


@njit(cache=True, error_model="numpy")
def scratch(n: int) -> Array:
    """Work space (14 + 2 n, n) of `learn` and `evaluate`, allocated once; n counts unknowns and omitted terms."""
    return np.empty((14 + 2 * n, n))


@njit(cache=True, error_model="numpy")
def learn(
    par: Array, colour: Array, kept: Array, equation: Array, elapsed: float, keep: float, moving: bool,
    angle: float, velocity: float, effort: float, basis: Array, work: Array,
) -> None:  # fmt: skip
    """Add one sample to the equation of a transmission.

    colour   autocorrelation of the torque noise, as `integral.rebase` takes it
    kept     KEPT and the basis of the sample before; updated
    elapsed  [s] since the sample before
    keep     lambda over that time
    moving   whether the sample is informative; integrals pause where it is not
    angle    [rad], velocity [rad/s] and effort [N m] of the motor
    basis    (terms + omitted,) f_j(phi) [rad]
    work     `scratch`
    """
    terms = int(par[P.terms])
    n, unit = terms + 3, row_unit(par)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    row, grown, moved = work[3], work[4], work[5]
    if moving and kept[KEPT.running] > 0.0:
        noise = elapsed * par[P.torque_noise]
        moved[0] = moved[1] = 0.0
        grown[1], grown[2] = velocity - kept[KEPT.velocity], angle - kept[KEPT.angle]
        for j in range(basis.size):
            grown[3 + j] = -0.5 * elapsed * (kept[KEPT.size + j] + basis[j])
        pushed = elapsed * effort
        for j in range(2, n):
            pushed -= grown[j] * mean[j]
        for j in range(2, grown.size):
            moved[j] = -grown[j] * width[min(j, n - 1)] / unit
        integral.rebase(equation, n, moved, pushed / unit, noise / unit, colour, work)
        if equation[integral.HEAD.poles] == 0.0:  # smoothed noise is measured by its smoother
            grown[0] = (pushed - grown[1] * mean[1]) / noise
            for j in range(1, n):
                grown[j] *= width[j] / noise
            integral.compare(equation, n, grown[:n])
        kept[KEPT.age] += elapsed
    if not moving:
        integral.interrupt(equation, n)
    # Rounded to the nearest sample, independent of rounding errors of the stamps.
    if kept[KEPT.running] > 0.0 and (not moving or kept[KEPT.age] + 0.5 * elapsed >= par[P.horizon]):
        integral.eliminate(equation, n)
        kept[KEPT.age] = 0.0
    integral.forget(equation, n, keep, work[6:])
    if moving:
        row[:] = 0.0
        row[0], row[1] = 1.0, velocity * width[1] / unit
        integral.take(equation, n, row, -velocity * mean[1] / unit)
    kept[KEPT.running] = 1.0 if moving else 0.0
    kept[KEPT.velocity], kept[KEPT.angle] = velocity, angle
    kept[KEPT.size : KEPT.size + basis.size] = basis


@njit(cache=True, error_model="numpy")
def evaluate(
    par: Array, kept: Array, equation: Array, warming: bool, phi: float, torque: float, taken_back: float,
    result: Array, work: Array,
) -> None:  # fmt: skip
    """Stiffness (43) at the deflection phi, its slope, B, D, and their variances into result (ESTIMATE.size,).

    torque      variance of the torque noise in units of the declared one
    taken_back  velocity noise in increments, in the same units, as `integral.noise` returns it
    work        `scratch`
    """
    kind, terms = int(par[P.basis]), int(par[P.terms])
    n, cut = terms + 3, omitted(kind)
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    x = integral.unknowns(equation, n)
    f, g, bend = work[0, : terms + cut], work[1, : terms + cut], work[2, : terms + cut]
    slopes = work[7 : 10 + cut]  # of stiffness, of B and D, of the last terms of either parity
    fill_basis(kind, phi, par[P.deflection_scale], f, g, bend)
    result[:] = 0.0
    slopes[:] = 0.0
    slopes[1, 1], slopes[2, 2] = width[1], width[2]
    result[E.inertia], result[E.damping] = mean[1], mean[2]
    if not warming:
        result[E.inertia] += width[1] * x[1]
        result[E.damping] += width[2] * x[2]
    for j in range(terms):
        share = mean[3 + j] + (0.0 if warming else width[3 + j] * x[3 + j])
        result[E.stiffness] += share * g[j]
        result[E.slope] += share * bend[j]
        slopes[0, 3 + j] = width[3 + j] * g[j]
        result[E.variances] += slopes[0, 3 + j] * slopes[0, 3 + j]
    result[E.variances + 1], result[E.variances + 2] = width[1] * width[1], width[2] * width[2]
    if warming:
        return
    for c in range(cut):
        last = max(n + c - cut, 3)
        slopes[3 + c, last] = width[last]
    blur = 0.5 * taken_back / (par[P.length] - 1.0)  # in a row, one velocity instead of two, and other units
    _set_variances(equation, slopes, torque, blur, work)
    result[E.variances :] = work[4, :3]
    if par[P.truncation] > 0.0:
        _add_truncation(par, kept, equation, g, work[4], result[E.variances :])


@njit(cache=True, error_model="numpy", forceinline=True)
def _set_variances(equation: Array, slopes: Array, torque: float, blur: float, work: Array) -> None:
    """Variances of slopes' x into work[4]; slopes (k, n + cut)."""
    n = slopes.shape[1] - int(equation[integral.HEAD.cut])
    prior, inverted, spare = work[3, :n], work[12:], work[12 + n :]
    integral.inverse(equation, n, inverted)
    prior[:] = 1.0
    prior[3:] = integral.prior_variance(equation, n, 3, inverted)
    integral.variances(equation, n, slopes, torque, blur, prior, inverted, spare, work[4])


@njit(cache=True, error_model="numpy", forceinline=True)
def _add_truncation(par: Array, kept: Array, equation: Array, g: Array, found: Array, variances: Array) -> None:
    """Add the squared error that each omitted term causes in stiffness, B and D to variances (3,).

    g      (terms + cut,) slopes of the basis at the deflection
    found  variances of slopes' x, as `_set_variances` leaves them
    """
    terms, cut = int(par[P.terms]), omitted(int(par[P.basis]))
    n = terms + 3
    width, x = par[P.size + n : P.size + 2 * n], integral.unknowns(equation, n)
    off = integral.considered(equation, n)
    for c in range(cut):
        size = par[P.truncation] * first_omitted(par, kept, x, off[c], c, found[3 + c])
        missed = g[terms + c]
        for j in range(terms):
            missed -= g[j] * off[c, 3 + j]
        variances[0] += (size * missed) ** 2
        for j in (1, 2):
            variances[j] += (size * off[c, j] * width[j] / width[n - 1]) ** 2


@njit(cache=True, error_model="numpy")
def omitted(kind: int) -> int:
    """Number of omitted terms considered: the next one of each parity that the basis has."""
    return 2 if kind in (POWERS, LEGENDRE) else 1


@njit(cache=True, error_model="numpy")
def fall(top: float, below: float, first: float, power: float) -> float:
    """c_(n+2) / c_n, at most 1, of Chebyshev coefficients whose ratio follows n^-p, p >= 0.

    top, below, first  c_n, c_(n-2), c_(n-4); first = 0 if unknown, then p = 0
    power              entry of `BENDING`
    """
    if below == 0.0:
        return 1.0
    per = 1.0 / below
    ratio = min(max(top * per, -1.0), 1.0)
    return ratio if first == 0.0 else ratio * min(abs(ratio * first * per), 1.0) ** power


@njit(cache=True, error_model="numpy")
def first_omitted(par: Array, visited: Array, x: Array, off: Array, c: int, doubt: float) -> float:
    """Expected coefficient [N m/rad] of the first term omitted, one of either parity for bases that have both.

    The Chebyshev coefficients c_n of stiffness over the range visited are assumed to decrease as those of smooth
    functions, c_n / c_(n-2) ~ n^-p, with p from the last three of the same parity: p = 0 near a singularity, 2 for
    entire functions such as sinh. If the spring law has more terms than the basis, the fitted coefficients are biased:
    an omitted coefficient t changes the last two by k t and h t, through the fit and through the Chebyshev polynomials
    that it contains. So t is the smallest solution consistent with both, found by iteration from below.

    Noise of the last coefficient would enter with a power, t ~ c_n^2 or higher, and overestimate t in some runs.
    Therefore the value that the lower coefficients predict for it, by the same rule, serves as its prior: its mean
    square given both is used, unless it exceeds its noise clearly, and never more than its size less its noise.

    x      (n,) estimates
    off    (n,) error of x per unit of the omitted coefficient
    c      index of the omitted term
    doubt  [(N m/rad)^2] variance of the last coefficient fitted
    """
    kind, terms, cut = int(par[P.basis]), int(par[P.terms]), omitted(int(par[P.basis]))
    n = terms + 3
    mean, width = par[P.size : P.size + n], par[P.size + n : P.size + 2 * n]
    far = max(abs(visited[VISITED.low]), abs(visited[VISITED.high])) / par[P.deflection_scale]
    j = max(n + c - cut, 3)
    share = mean[j] + width[j] * x[j]
    if share == 0.0 or far == 0.0:
        return 0.0
    clear = share * share / sqrt(share * share + 4.0 * doubt)  # size without its noise
    size, next_size = swing_of_last(kind, terms, n - 1 - j, far), swing_of_last(kind, terms, -1 - c, far)
    i = j - cut
    if i < 3 or j + cut != n + c:
        return size * clear / next_size
    before, lower = swing_of_last(kind, terms, n - 1 - i, far), swing_before(kind, terms, n - 1 - j, far, 1)
    b, first, zeroth, degree = before * (mean[i] + width[i] * x[i]), 0.0, 0.0, (3 - cut) * (j - 3)
    if i - cut >= 3:
        first = swing_of_last(kind, terms, n - 1 - i + cut, far) * (mean[i - cut] + width[i - cut] * x[i - cut])
        first += swing_before(kind, terms, n - 1 - i, far, 1) * b
        first += swing_before(kind, terms, n - 1 - j, far, 2) * size * share
    b += lower * size * share
    if degree == 6:  # c_0, halved in a series: from the value at 0, where all other polynomials are 1 or -1
        zeroth = first - b + size * share
        for at in range(4):
            known = mean[3 + at * cut] + width[3 + at * cut] * x[3 + at * cut]
            zeroth += known * (LEGENDRE_AT_0[at] if kind in (LEGENDRE, ODD_LEGENDRE) else 1.0 if at == 0 else 0.0)
    expected = b / size * (fall(b, first, 2.0 * zeroth, BENDING[degree - 2]) if first != 0.0 else 1.0)
    wide = max(expected * expected, share * share - CLEAR * CLEAR * doubt)
    if wide + doubt > 0.0:
        known = wide / (wide + doubt)
        clear = min(clear, sqrt(known * (known * share * share + doubt)))
    a = (1.0 if share > 0.0 else -1.0) * size * clear
    k = size * off[j] / next_size - swing_before(kind, terms, -1 - c, far, 1)
    h = (before * off[i] + lower * size * off[j]) / next_size - swing_before(kind, terms, -1 - c, far, 2)
    t, ratio, power = 0.0, 0.0, BENDING[degree]
    for _ in range(ROUNDS):
        top = a - min(max(k * t, -abs(a)), 0.5 * abs(a))  # bounded by the coefficient itself
        below = b - min(max(h * t, -abs(b)), 0.5 * abs(b))
        ratio = fall(top, below, first, power)
        t = top * ratio
    tail = 1.0 / (1.0 - min(abs(ratio), 0.5))  # at the ends of the range all omitted terms add up
    return tail * min(abs(t), abs(a)) / next_size


@njit(cache=True, error_model="numpy", forceinline=True)
def report(
    found: Array, i: int, blur: float, q_variance: float, learning: bool, value: Array, sd: Array, joint: Array
) -> None:
    """Write the estimate `found` (N_ESTIMATE,) of transmission i to the outputs and add it to the joint.

    blur        variance of stiffness [(N m/rad)^2] due to the noise of the present deflection
    q_variance  [rad^2] of the link angle
    """
    m, at = (value.size - 1) // 3, E.variances
    transmissions.update(value, sd, 1 + i, found[E.stiffness], sqrt(found[at] + blur), learning)
    transmissions.update(value, sd, 1 + m + i, found[E.inertia], sqrt(found[at + 1]), learning)
    transmissions.update(value, sd, 1 + 2 * m + i, found[E.damping], sqrt(found[at + 2]), learning)
    transmissions.add(joint, found[E.stiffness], sd[1 + i], found[E.slope], q_variance, 0.0)
