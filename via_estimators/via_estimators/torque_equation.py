"""The modulated torque equation of one motor as regressors of its unknowns, and the stiffness of a spring law in them.

Source and equation: `modulated_torque`. Unknowns are U, then the coefficients a_p, then the trend of
`interacting_models`; each is its prior mean plus its prior standard deviation times x.

Three unknowns describe a transmission that is not a spring law of phi alone:

hysteresis  H z, dz = dphi / l within -1..1, l = LONG: friction inside the spring, an elastic element that yields
creep       k_c (phi - x), dx = (phi - x) dt / CREEP: a part of the spring relaxes. The stiffness reported is that of a
            sudden deflection, sigma + k_c. If the relaxation time is not CREEP, least squares in motion of .1 to 5 Hz
            find a sum sigma + k_c that is wrong by up to .35 k_c for times of .2 to 2 s: a standard deviation of
            COARSE k_c (`coarseness`). A faster relaxation looks like damping and is no part of the stiffness.
play        p sat(phi), within -PLAY..PLAY: a spring that is softer near 0. With backlash of any width b up to 2 PLAY,
            p = -k b / PLAY gives the torque outside; inside 2 PLAY the stiffness is uncertain by p.
"""

from __future__ import annotations

from math import exp, sqrt

from numba import njit
from via_core.signals import Array

from via_estimators.slots import slots
from via_estimators.spring_series import power, tail
from via_estimators.transmissions import VISITED

REACH = 0.05  # [windows] to each side, over which a motor's direction is measured
QUANTUM = sqrt(12.0)  # encoder step over the standard deviation of its rounding
# Followed by the means (n,) and the standard deviations (n,) of the prior.
P = slots(
    "length", "transmissions", "order", "even_terms", "memory", "max_gap", "torque_noise", "position_noise",
    "deflection_scale", "minimum_motion", "range_margin", "truncation", "modulating_order",
    "torque_scale_deviation", "steadiness", "preset_terms",
)  # fmt: skip
# Followed by the coefficients of the spring law, those in proportion to the preset last. Dry friction is the sum of the
# four from `friction` to `long` where the motor moves; `stuck` is its part in proportion to the deflection elsewhere.
U = slots(
    "inertia", "damping", "friction", "slow", "short", "long", "stuck", "loss", "delay", "lag", "scale", "gear",
    "hysteresis", "creep", "play",
)  # fmt: skip
LAG = 0.5  # standard deviation of `lag`, s: .5 for a first-order filter, 0 for a delay, -.5 for a filter that rings
SLOW = 0.1  # [rad/s] at which the friction `slow` saturates
SHORT, LONG = 2e-3, 2e-2  # [rad] travel over which the frictions `short` and `long` build up
CREEP, COARSE = 0.3, 0.35  # [s]; share of the stiffness that relaxes
PLAY = 5e-3  # [rad]
COLUMNS = 8  # of a transmission in the ring
THETA, TAU, PHI, ON_SHORT, ON_LONG, ON_SPRING, RELAXED, PRESET = range(COLUMNS)


@njit(cache=True, error_model="numpy")
def _tail(term: int, order: int, far: float, mean: Array, width: Array, x: Array, covariance: Array) -> float:
    """`spring_series.tail` of a term."""
    j = U.size + term
    share, variance = mean[j] + width[j] * x[j], width[j] * width[j] * covariance[j, j]
    return tail(power(term, order) - 1, far, share, variance)


@njit(cache=True, error_model="numpy")
def _friction(own: Array, psi: Array, quantum: float, step: float, row: Array) -> float:
    """Write the regressors of dry friction and of `stuck` into row (n,); returns the share <u, psi> that sticks.

    The change of the angle over REACH to each side has a sign if it is at least two encoder steps, u = 0; a motor that
    sticks has none, u = 1, and friction may then have any value up to its limit.
    """
    theta, length = own[THETA], own.shape[1]
    reach = max(int(REACH * length), 1)
    share = 0.0
    for k in range(length):
        after, before = min(k + reach, length - 1), max(k - reach, 0)
        change = theta[after] - theta[before]
        sign = 1.0 if change > 0.0 else -1.0 if change < 0.0 else 0.0
        if abs(change) < 2.0 * quantum:
            sign = 0.5 * change / quantum
        unknown = psi[k] * (1.0 - abs(sign))
        share += unknown
        row[U.friction] += psi[k] * sign
        row[U.slow] += psi[k] * min(max(change / ((after - before) * step * SLOW), -1.0), 1.0)
        row[U.short] += psi[k] * own[ON_SHORT, k]
        row[U.long] += psi[k] * own[ON_LONG, k]
        row[U.stuck] += unknown * own[PHI, k]
    return share


@njit(cache=True, error_model="numpy")
def slide(ring: Array, before: int, slot: int, step: float) -> None:
    """Write the states of the friction elements and of the creeping part at `slot` of a ring (8, L).

    before  sample before, < 0 if there is none: nothing is built up then, and the spring is relaxed
    step    [s] since then
    """
    phi = ring[PHI, slot]
    if before < 0:
        ring[ON_SHORT, slot] = ring[ON_LONG, slot] = ring[ON_SPRING, slot] = 0.0
        ring[RELAXED, slot] = phi
        return
    moved = ring[THETA, slot] - ring[THETA, before]
    ring[ON_SHORT, slot] = min(max(ring[ON_SHORT, before] + moved / SHORT, -1.0), 1.0)
    ring[ON_LONG, slot] = min(max(ring[ON_LONG, before] + moved / LONG, -1.0), 1.0)
    ring[ON_SPRING, slot] = min(max(ring[ON_SPRING, before] + (phi - ring[PHI, before]) / LONG, -1.0), 1.0)
    middle = 0.5 * (phi + ring[PHI, before])
    ring[RELAXED, slot] = middle + (ring[RELAXED, before] - middle) * exp(-step / CREEP)


@njit(cache=True, error_model="numpy")
def fill_row(
    par: Array, psi: Array, held: Array, late: Array, own: Array, span: float, delay: float, row: Array
) -> tuple[float, float]:  # fmt: skip
    """Write the modulated equation's regressors into row (n,); returns its left side and the share without direction.

    span   [s] of the window
    own    (8, L) columns of the window, oldest first
    delay  [s] estimated so far
    """
    order, scale, quantum = int(par[P.order]), par[P.deflection_scale], par[P.position_noise] * QUANTUM
    theta, tau, phi, preset = own[THETA], own[TAU], own[PHI], own[PRESET]
    varied = row.size - 1 - int(par[P.preset_terms])  # first of the terms in proportion to the preset
    y = 0.0
    row[:] = 0.0
    for k in range(phi.size):
        y += (held[k] + 0.5 * delay * delay * psi[2, k]) * tau[k]
        row[U.inertia] += psi[2, k] * theta[k]
        row[U.damping] -= psi[1, k] * theta[k]
        row[U.loss] += psi[1, k] * phi[k]
        row[U.delay] += late[k] * tau[k]
        row[U.lag] += delay * delay * psi[2, k] * tau[k]
        row[U.hysteresis] -= psi[0, k] * own[ON_SPRING, k]
        row[U.creep] -= psi[0, k] * (phi[k] - own[RELAXED, k])
        row[U.play] -= psi[0, k] * min(max(phi[k], -PLAY), PLAY)
        z = phi[k] / scale
        weight, squared = psi[0, k] * scale, z * z
        odd, even = weight * z, weight
        for term in range(order):
            row[U.size + term] -= odd / (2 * term + 1)
            odd *= squared
        for term in range(order, varied - U.size):
            row[U.size + term] -= even / max(2 * (term - order), 1)
            even *= squared
        odd = weight * z * preset[k]
        for term in range(row.size - 1 - varied):
            row[varied + term] -= odd / (2 * term + 1)
            odd *= squared
    return y, _friction(own, psi[0], quantum, span / (phi.size - 1), row)


@njit(cache=True, error_model="numpy")
def of_noise(psi: Array, held: Array, stiffness: float, inertia: float, damping: float) -> tuple[float, float]:
    """Variance of a row's equation per variance of a torque and of an angle, at psi (3, L) and `held` (L,)."""
    within = angles = 0.0
    for k in range(held.size):
        of_link = stiffness * psi[0, k]
        of_motor = inertia * psi[2, k] - damping * psi[1, k] + of_link
        within += held[k] * held[k]
        angles += of_motor * of_motor + of_link * of_link
    return within, angles


@njit(cache=True, error_model="numpy")
def gear(par: Array, mean: Array, width: Array, x: Array, psi: Array, own: Array) -> float:
    """<|tau_e(phi)| z_1, psi> with the spring law found so far, for a gear whose friction grows with its load."""
    order, scale, total = int(par[P.order]), par[P.deflection_scale], 0.0
    phi, preset, on_short = own[PHI], own[PRESET], own[ON_SHORT]
    varied = x.size - 1 - int(par[P.preset_terms])
    shares = mean[U.size :] + width[U.size :] * x[U.size :]
    for k in range(phi.size):
        z, load = phi[k] / scale, 0.0
        squared, odd, even, adjusted = z * z, z, 1.0, z * preset[k]
        for term in range(order):
            load += shares[term] * odd / (2 * term + 1)
            odd *= squared
        for term in range(order, varied - U.size):
            load += shares[term] * even / max(2 * (term - order), 1)
            even *= squared
        for term in range(x.size - 1 - varied):
            load += shares[varied - U.size + term] * adjusted / (2 * term + 1)
            adjusted *= squared
        total += psi[k] * abs(load * scale) * on_short[k]
    return total


@njit(cache=True, error_model="numpy")
def rescale(mean: Array, width: Array, x: Array, row: Array) -> tuple[float, float]:
    """Make `row` (n,) the regressors of torques whose scale is s = 1 + c; returns s_0 and what to add to the left side.

    y = s r'a + late is linearised about the estimate s_0, a_0: y + (s_0 - 1) r'a_0 = s_0 r'a + c r'a_0 + late, with the
    terms `late` of delay and lag, which contain the torque itself
    """
    scale, predicted = 1.0 + x[U.scale], 0.0
    for j in range(x.size):
        if j != U.delay and j != U.lag:
            predicted += row[j] * (mean[j] + width[j] * x[j])
            row[j] *= scale
    row[U.scale] = predicted
    return scale, (scale - 1.0) * predicted


@njit(cache=True, error_model="numpy")
def stiffness(
    par: Array, mean: Array, width: Array, x: Array, phi: float, preset: float, slope: Array
) -> tuple[float, float]:  # fmt: skip
    """Stiffness [N m/rad] and its derivative by phi at phi and preset [rad]; d stiffness / dx into slope (n,)."""
    order, z = int(par[P.order]), phi / par[P.deflection_scale]
    varied = x.size - 1 - int(par[P.preset_terms])
    slope[: U.size], slope[x.size - 1] = 0.0, 0.0
    slope[U.creep] = width[U.creep]
    slope[U.play] = width[U.play] if abs(phi) < PLAY else 0.0
    stiffness, bend = slope[U.creep] * x[U.creep] + slope[U.play] * x[U.play], 0.0
    for j in range(U.size, x.size - 1):
        p, factor = (power(j - U.size, order), 1.0) if j < varied else (2 * (j - varied) + 1, preset)
        share = mean[j] + width[j] * x[j]
        rise = factor * z ** (p - 1) if p > 0 else 0.0
        slope[j] = width[j] * rise
        stiffness += share * rise
        bend += factor * share * (p - 1) * z ** (p - 2) / par[P.deflection_scale] if p > 1 else 0.0
    return stiffness, bend


@njit(cache=True, error_model="numpy")
def truncation(
    par: Array, mean: Array, width: Array, kept: Array, x: Array, covariance: Array, preset: float
) -> float:  # fmt: skip
    """Variance of stiffness [(N m/rad)^2] due to the terms left out: odd, even, and in proportion to the preset."""
    order, even, varied = int(par[P.order]), int(par[P.even_terms]), int(par[P.preset_terms])
    if not par[P.truncation] > 0.0:
        return 0.0
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    total = _tail(order - 1, order, far, mean, width, x, covariance)
    if even > 1:
        total += _tail(order + even - 1, order, far, mean, width, x, covariance)
    if varied > 1:
        j = x.size - 2
        share, variance = mean[j] + width[j] * x[j], width[j] * width[j] * covariance[j, j]
        total += preset * preset * tail(2 * (varied - 1), far, share, variance)
    return par[P.truncation] ** 2 * total


@njit(cache=True, error_model="numpy", inline="always")
def _beyond_noise(width: Array, x: Array, covariance: Array, j: int) -> float:
    """Square of unknown j, whose prior mean is 0, less what two standard deviations explain."""
    return width[j] ** 2 * max(x[j] * x[j] - 4.0 * covariance[j, j], 0.0)


@njit(cache=True, error_model="numpy")
def coarseness(width: Array, x: Array, covariance: Array, phi: float) -> float:
    """Variance of stiffness [(N m/rad)^2] at phi [rad], since one element stands for any relaxation time or play."""
    total = COARSE**2 * _beyond_noise(width, x, covariance, U.creep)
    if abs(phi) < 2.0 * PLAY:
        total += _beyond_noise(width, x, covariance, U.play)
    return total
