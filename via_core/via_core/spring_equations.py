"""Equations of the spring laws (eqs. 1-8, 50-51): torque, stiffness and its slope as compiled scalar functions.

Each takes the `kind` of a spring law, a row of its coefficients, the deflection phi = q - theta [rad] and a `preset`
[rad] (both are defined in via_core.springs), so that one compiled kernel serves all spring laws.
"""

from __future__ import annotations

from math import asin, cos, cosh, exp, sin, sinh, sqrt

from numba import njit

from via_core.signals import Array

ODD_POLYNOMIAL, SINH, FOUR_BAR, MACCEPA, EXPONENTIAL, TWO_LEVER = range(6)
N_COEFFICIENTS = 8  # length of a coefficient row


@njit(cache=True, error_model="numpy")
def _between_levers(c: Array, phi: float, preset: float) -> tuple[float, float, float]:
    """Length [m] of a TWO_LEVER spring; its motor end across and along the link's lever [m]."""
    motor_lever, a, h, d, side = c[2], c[3], c[4], c[5], c[6]
    x, u = side * (phi + preset), -side * preset
    tip_x, tip_y = h + motor_lever * sin(u), motor_lever * cos(u) - d
    across = sin(x) * tip_x - cos(x) * tip_y
    along = cos(x) * tip_x + sin(x) * tip_y
    return sqrt(tip_x * tip_x + tip_y * tip_y + a * a - 2.0 * a * along), across, along


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def odd_polynomial(c: Array, phi: float) -> float:
    """sum_p c_p phi^(2p+1) [N m] with coefficients c (n,), an array or a tuple."""
    last = len(c) - 1
    square, total = phi * phi, c[last]
    for p in range(last - 1, -1, -1):
        total = total * square + c[p]
    return total * phi


@njit(cache=True, error_model="numpy", forceinline=True, _nrt=False)
def polynomial_slope(c: Array, phi: float) -> float:
    """Derivative [N m/rad] of `odd_polynomial`."""
    last = len(c) - 1
    square, total = phi * phi, (2 * last + 1) * c[last]
    for p in range(last - 1, -1, -1):
        total = total * square + (2 * p + 1) * c[p]
    return total


@njit(cache=True, error_model="numpy")
def spring_torque(kind: int, c: Array, phi: float, preset: float) -> float:
    """tau_e(phi) [N m] of spring law `kind` with coefficients c (8,)."""
    if kind == ODD_POLYNOMIAL:  # sum_p c_p phi^(2p+1)
        return odd_polynomial(c, phi)
    if kind == SINH:  # k sinh(a phi)
        return c[0] * sinh(c[1] * phi)
    if kind == FOUR_BAR:  # 2 k beta dbeta/dphi, eqs. (50)-(51)
        s = c[1] * sin(0.5 * phi)
        root = sqrt(1.0 - s * s)
        beta = asin(s) - 0.5 * phi
        slope = 0.5 * c[1] * cos(0.5 * phi) / root - 0.5
        return 2.0 * c[0] * beta * slope
    if kind == MACCEPA:  # K B C sin(phi) (1 + (r preset - A0) / A), A the length from lever tip to base
        kbc, b2_c2, two_bc, r, a0 = c[0], c[1], c[2], c[3], c[4]
        length = sqrt(b2_c2 - two_bc * cos(phi))
        return kbc * sin(phi) * (1.0 + (r * preset - a0) / length)
    if kind == EXPONENTIAL:  # k (rise e^(a phi) - fall e^(-a phi))
        return c[0] * exp(c[2] * phi) - c[1] * exp(-c[2] * phi)
    # TWO_LEVER: moment K (1 - s0/s) (a x s) of a spring between the tips of a link lever and a motor lever
    k, s0, a, side = c[0], c[1], c[3], c[6]
    length, across, _ = _between_levers(c, phi, preset)
    return side * k * a * (1.0 - s0 / length) * across


@njit(cache=True, error_model="numpy")
def spring_stiffness(kind: int, c: Array, phi: float, preset: float) -> float:
    """sigma(phi) [N m/rad] of spring law `kind` with coefficients c (8,)."""
    if kind == ODD_POLYNOMIAL:
        return polynomial_slope(c, phi)
    if kind == SINH:
        return c[0] * c[1] * cosh(c[1] * phi)
    if kind == FOUR_BAR:
        s = c[1] * sin(0.5 * phi)
        half_cos = 0.5 * c[1] * cos(0.5 * phi)
        root = sqrt(1.0 - s * s)
        beta = asin(s) - 0.5 * phi
        slope = half_cos / root - 0.5
        bend = -0.25 * s / root + s * half_cos * half_cos / (root * root * root)
        return 2.0 * c[0] * (slope * slope + beta * bend)
    if kind == MACCEPA:
        kbc, b2_c2, two_bc, r, a0 = c[0], c[1], c[2], c[3], c[4]
        length = sqrt(b2_c2 - two_bc * cos(phi))
        pull = r * preset - a0
        bent = 0.5 * two_bc * sin(phi) * sin(phi) / (length * length * length)
        return kbc * (cos(phi) * (1.0 + pull / length) - pull * bent)
    if kind == EXPONENTIAL:
        return c[2] * (c[0] * exp(c[2] * phi) + c[1] * exp(-c[2] * phi))
    k, s0, a = c[0], c[1], c[3]
    length, across, along = _between_levers(c, phi, preset)
    return k * a * ((1.0 - s0 / length) * along + s0 * a * across * across / (length * length * length))


@njit(cache=True, error_model="numpy")
def spring_stiffness_slope(kind: int, c: Array, phi: float, preset: float) -> float:
    """d sigma / d phi [N m/rad^2] of spring law `kind` with coefficients c (8,)."""
    if kind == ODD_POLYNOMIAL:
        square = phi * phi
        total = 0.0
        for p in range(N_COEFFICIENTS - 1, 0, -1):
            total = total * square + 2 * p * (2 * p + 1) * c[p]
        return total * phi
    if kind == SINH:
        return c[0] * c[1] * c[1] * sinh(c[1] * phi)
    if kind == FOUR_BAR:  # 2 k (3 slope bend + beta third), the first three derivatives of beta
        s = c[1] * sin(0.5 * phi)
        d = 0.5 * c[1] * cos(0.5 * phi)
        root = sqrt(1.0 - s * s)
        beta = asin(s) - 0.5 * phi
        slope = d / root - 0.5
        bend = -0.25 * s / root + s * d * d / root**3
        third = -0.25 * d / root + (d * d - 0.75 * s * s) * d / root**3 + 3.0 * s * s * d**3 / root**5
        return 2.0 * c[0] * (3.0 * slope * bend + beta * third)
    if kind == MACCEPA:
        kbc, b2_c2, two_bc, r, a0 = c[0], c[1], c[2], c[3], c[4]
        length = sqrt(b2_c2 - two_bc * cos(phi))
        pull = r * preset - a0
        lean = 0.5 * two_bc * sin(phi) / (length * length)
        bent = 3.0 * pull / length * lean * (lean * sin(phi) - cos(phi))
        return kbc * (bent - sin(phi) * (1.0 + pull / length))
    if kind == EXPONENTIAL:
        return c[2] * c[2] * (c[0] * exp(c[2] * phi) - c[1] * exp(-c[2] * phi))
    k, s0, a, side = c[0], c[1], c[3], c[6]
    length, across, along = _between_levers(c, phi, preset)
    bent = 3.0 * s0 * a / length**3 * (along - a * across * across / (length * length))
    return side * k * a * across * (bent - (1.0 - s0 / length))
