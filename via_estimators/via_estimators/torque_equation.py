"""The modulated torque equations of motors and link as regressors of their unknowns, and the stiffness in these.

Source and equations: `modulated_torque`. The unknowns are a block of each transmission, U and then the coefficients
a_p, then LINK, then the trends of `interacting_models`; each is its prior mean plus its prior standard deviation
times x.
"""

from __future__ import annotations

from math import cos, sin, sqrt

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
    "torque_scale_deviation", "steadiness", "force_deviation", "force_noise",
)  # fmt: skip
U = slots("inertia", "damping", "friction", "slow", "delay")  # followed by the coefficients of the spring law
LINK = slots("inertia", "damping", "friction", "slow", "sine", "cosine")  # gravity is sine sin q + cosine cos q
SLOW = 0.1  # [rad/s] at which the friction `slow` saturates
THETA, TAU, PHI = range(3)  # columns of a transmission in the ring


@njit(cache=True, error_model="numpy")
def _tail(term: int, order: int, far: float, mean: Array, width: Array, x: Array, covariance: Array) -> float:
    """`spring_series.tail` of a term."""
    j = U.size + term
    share, variance = mean[j] + width[j] * x[j], width[j] * width[j] * covariance[j, j]
    return tail(power(term, order) - 1, far, share, variance)


@njit(cache=True, error_model="numpy")
def _friction(theta: Array, psi: Array, quantum: float, step: float) -> tuple[float, float, float]:
    """<sign v, psi> and <v / SLOW within -1..1, psi> of the motor's velocity v, and the share of unknown sign.

    The change of the angle over REACH to each side, or over the time of an encoder step at SLOW if that is longer, has
    a sign if it is at least two encoder steps; a motor that sticks has none, and friction may then have any value up
    to its limit.
    """
    length = theta.size
    reach = max(int(max(REACH * length, quantum / (SLOW * step))), 1)
    total = slow = unknown = 0.0
    for k in range(length):
        after, before = min(k + reach, length - 1), max(k - reach, 0)
        change = theta[after] - theta[before]
        slow += psi[k] * min(max(change / ((after - before) * step * SLOW), -1.0), 1.0)
        sign = 1.0 if change > 0.0 else -1.0 if change < 0.0 else 0.0
        if abs(change) < 2.0 * quantum:
            sign = 0.5 * change / quantum
        total += psi[k] * sign
        unknown += psi[k] * (1.0 - abs(sign))
    return total, slow, unknown


@njit(cache=True, error_model="numpy")
def fill_spring(par: Array, psi: Array, phi: Array, sign: float, row: Array) -> None:
    """Add sign <f_p(phi), psi> to the coefficients in row (b,) of a transmission's block; phi (L,) of the window."""
    order, scale = int(par[P.order]), par[P.deflection_scale]
    for k in range(phi.size):
        z = phi[k] / scale
        weight, squared = sign * psi[0, k] * scale, z * z
        odd, even = weight * z, weight
        for term in range(order):
            row[U.size + term] += odd / (2 * term + 1)
            odd *= squared
        for term in range(order, row.size - U.size):
            row[U.size + term] += even / max(2 * (term - order), 1)
            even *= squared


@njit(cache=True, error_model="numpy")
def fill_motor(
    par: Array, psi: Array, held: Array, late: Array, own: Array, span: float, delay: float, row: Array
) -> tuple[float, float]:  # fmt: skip
    """Write the motor equation's regressors into its block; returns its left side and the share without direction.

    span   [s] of the window
    own    (3, L) THETA, TAU, PHI of the window, oldest first
    delay  [s] estimated so far
    row    (b,) of the transmission's block
    """
    quantum = par[P.position_noise] * QUANTUM
    theta, tau, phi = own[THETA], own[TAU], own[PHI]
    y = 0.0
    row[:] = 0.0
    for k in range(phi.size):
        y += (held[k] + 0.5 * delay * delay * psi[2, k]) * tau[k]
        row[U.inertia] += psi[2, k] * theta[k]
        row[U.damping] -= psi[1, k] * theta[k]
        row[U.delay] += late[k] * tau[k]
    fill_spring(par, psi, phi, -1.0, row)
    row[U.friction], row[U.slow], unknown = _friction(theta, psi[0], quantum, span / (phi.size - 1))
    return y, unknown


@njit(cache=True, error_model="numpy")
def fill_link(par: Array, psi: Array, own: Array, span: float, row: Array) -> float:
    """Write the regressors of LINK into row (LINK.size,); returns the share without direction.

    own  (3, L) of any transmission
    """
    length, quantum = psi.shape[1], par[P.position_noise] * QUANTUM
    q = own[THETA] + own[PHI]
    row[:] = 0.0
    for k in range(length):
        row[LINK.inertia] += psi[2, k] * q[k]
        row[LINK.damping] -= psi[1, k] * q[k]
        row[LINK.sine] += psi[0, k] * sin(q[k])
        row[LINK.cosine] += psi[0, k] * cos(q[k])
    row[LINK.friction], row[LINK.slow], unknown = _friction(q, psi[0], quantum, span / (length - 1))
    return unknown


@njit(cache=True, error_model="numpy")
def link_noise(par: Array, psi: Array, link: Array, doubt: float, stiff: Array, noisy: Array, slopes: Array) -> float:
    """Variance of the link equation by encoder noise, x' Sigma x, and Sigma x in parts.

    Noise n of q adds <n, M psi'' - D psi' + psi sum_i sigma_i>, that of theta_i takes sigma_i <n, psi>.

    link    (LINK.size,) unknowns
    doubt   variance of the inertia, which adds to that of the noise
    stiff   (m,) stiffnesses sigma_i in the middle of the window
    noisy   (2,) of inertia and damping, overwritten
    slopes  (m,) derivatives by sigma_i, overwritten
    """
    short = curved = rate = bend = total = squares = 0.0
    for k in range(psi.shape[1]):
        short += psi[0, k] * psi[0, k]
        curved += psi[0, k] * psi[2, k]
        rate += psi[1, k] * psi[1, k]
        bend += psi[2, k] * psi[2, k]
    square, M, D = par[P.position_noise] ** 2, link[LINK.inertia], link[LINK.damping]
    for i in range(stiff.size):
        total += stiff[i]
        squares += stiff[i] * stiff[i]
    noisy[0], noisy[1] = square * (M * bend + total * curved), square * D * rate
    for i in range(stiff.size):
        slopes[i] = square * (M * curved + (total + stiff[i]) * short)
    found = (M * M + doubt) * bend + D * D * rate + (total * total + squares) * short + 2.0 * M * total * curved
    return square * found + par[P.force_noise] ** 2 * short


@njit(cache=True, error_model="numpy")
def stiffness(par: Array, mean: Array, width: Array, x: Array, phi: float, slope: Array) -> tuple[float, float]:
    """Stiffness [N m/rad] and its derivative by phi at phi [rad]; slope (b,) = d stiffness / dx, overwritten.

    mean, width, x  (b,) of the transmission's block
    """
    order, z = int(par[P.order]), phi / par[P.deflection_scale]
    stiffness, bend = 0.0, 0.0
    slope[: U.size] = 0.0
    for j in range(U.size, x.size):
        p = power(j - U.size, order)
        share = mean[j] + width[j] * x[j]
        rise = z ** (p - 1) if p > 0 else 0.0
        slope[j] = width[j] * rise
        stiffness += share * rise
        bend += share * (p - 1) * z ** (p - 2) / par[P.deflection_scale] if p > 1 else 0.0
    return stiffness, bend


@njit(cache=True, error_model="numpy")
def truncation(par: Array, mean: Array, width: Array, kept: Array, x: Array, covariance: Array) -> float:
    """Variance of stiffness [(N m/rad)^2] due to the terms left out, of either parity."""
    order, even = int(par[P.order]), int(par[P.even_terms])
    if not par[P.truncation] > 0.0:
        return 0.0
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    total = _tail(order - 1, order, far, mean, width, x, covariance)
    if even > 1:
        total += _tail(order + even - 1, order, far, mean, width, x, covariance)
    return par[P.truncation] ** 2 * total
