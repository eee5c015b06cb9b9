"""Bases of spring laws, tau_e(phi) as a sum of functions, with their derivatives; each basis has an integer kind.

    tau_e(phi) = sum_j a_j f_j(phi),   f_j(phi) = s F_j(phi / s),   g_j = df_j/dphi = F_j'(phi / s),   f_1 = phi

Source: SAPHARI deliverable, eqs. (37), (43). Every f_j vanishes at phi = 0: the printed f_i = phi^(i-1) begins with a
constant, which has no stiffness (and cannot be distinguished from the constant of the integral equation). The slopes
are scaled so that each a_j [N m/rad] contributes to stiffness at the deflection scale s:

    powers        g_j = z^(j-1)           the document's choice, z = phi / s
    odd_powers    g_j = z^(2j-2)          for tau_e(-phi) = -tau_e(phi)
    legendre      g_j = P_(j-1)(z)        spans what `powers` spans, far better conditioned over |z| <= 1
    odd_legendre  g_j = P_(2j-2)(z)       spans what `odd_powers` spans
"""

from __future__ import annotations

from numba import njit
from via_core.signals import Array

POWERS, ODD_POWERS, LEGENDRE, ODD_LEGENDRE = range(4)  # kinds
BASES = {"powers": POWERS, "odd_powers": ODD_POWERS, "legendre": LEGENDRE, "odd_legendre": ODD_LEGENDRE}
MOST_TERMS = 10


@njit(cache=True, error_model="numpy")
def fill_basis(kind: int, phi: float, scale: float, f: Array, g: Array, bend: Array) -> None:
    """f_j(phi) [rad], its slope g_j [-] and its second derivative [1/rad] into f, g, bend (m,), all overwritten.

    kind   one of the constants above
    scale  s > 0 [rad]
    """
    z = phi / scale
    legendre = kind in (LEGENDRE, ODD_LEGENDRE)
    every = 2 if kind in (ODD_POWERS, ODD_LEGENDRE) else 1
    # Degree by degree: v = value, d = derivative of the slope's polynomial, F = integral of it from 0 to z.
    before, v, d_before, d = 0.0, 1.0, 0.0, 0.0
    at_zero_before, at_zero = 0.0, 1.0  # Legendre polynomials at 0
    degree = 0
    for j in range(f.size):
        while degree < every * j:
            if legendre:  # (n + 1) P_(n+1) = (2n + 1) z P_n - n P_(n-1),  P'_(n+1) = P'_(n-1) + (2n + 1) P_n
                ahead = ((2 * degree + 1) * z * v - degree * before) / (degree + 1)
                d_ahead = d_before + (2 * degree + 1) * v
                zero_ahead = -degree * at_zero_before / (degree + 1)
                before, v, d_before, d = v, ahead, d, d_ahead
                at_zero_before, at_zero = at_zero, zero_ahead
            else:
                d = (degree + 1) * v
                v *= z
            degree += 1
        if legendre:  # integral of P_n = (P_(n+1) - P_(n-1)) / (2n + 1)
            ahead = ((2 * degree + 1) * z * v - degree * before) / (degree + 1)
            zero_ahead = -degree * at_zero_before / (degree + 1)
            f[j] = scale * ((ahead - before) - (zero_ahead - at_zero_before)) / (2 * degree + 1)
        else:
            f[j] = scale * v * z / (degree + 1)
        g[j] = v
        bend[j] = d / scale


@njit(cache=True, error_model="numpy")
def swing_of_last(kind: int, terms: int, back: int, far: float) -> float:
    """Size [-] of the highest Chebyshev polynomial in a term's slope, over |phi| <= far s, per unit of its a_j.

    A power n of z contains 2^(1-n) far^n of the Chebyshev polynomial T_n; the rest are lower powers.

    back  0 for the last of the terms, 1 for the one before
    """
    j = terms - 1 - back
    n = 2 * j if kind in (ODD_POWERS, ODD_LEGENDRE) else j
    if n < 1:
        return 1.0
    size = 2.0 * (0.5 * far) ** n
    if kind in (LEGENDRE, ODD_LEGENDRE):  # leading coefficient (2n)! / (2^n n!^2)
        for i in range(1, n + 1):
            size *= (2.0 * i - 1.0) / i
    return size


@njit(cache=True, error_model="numpy")
def swing_before(kind: int, terms: int, back: int, far: float, steps: int) -> float:
    """Coefficient [-] of a lower Chebyshev polynomial of the same parity, T_(n - 2 steps), in a term's slope.

    Per unit of `swing_of_last` of the same term, z^n = 2^(1-n) (T_n + n T_(n-2) + n (n - 1) / 2 T_(n-4) + ..), T_0
    halved.

    steps  1 or 2
    """
    j = terms - 1 - back
    n = 2 * j if kind in (ODD_POWERS, ODD_LEGENDRE) else j
    if n < 2 * steps:
        return 0.0
    share = float(n) if steps == 1 else 0.5 * n * (n - 1.0)
    if kind in (LEGENDRE, ODD_LEGENDRE):  # next terms: -n (n - 1) / (2 (2n - 1)) z^(n-2) per z^n, ...
        second = -n * (n - 1.0) / (2.0 * (2.0 * n - 1.0)) * 4.0 / (far * far)
        if steps == 1:
            share += second
        else:
            third = -(n - 2.0) * (n - 3.0) / (4.0 * (2.0 * n - 3.0)) * 4.0 / (far * far) * second
            share += second * (n - 2.0) + third
    return 0.5 * share if n == 2 * steps else share
