"""phi functions of exponential integrators: phi_0 = exp(z), phi_k(z) = int_0^1 exp((1-s) z) s^(k-1) / (k-1)! ds.

The recursion phi_{k+1}(z) = (phi_k(z) - 1/k!) / z suffers from cancellation near z = 0. There phi_4 is summed as its
Taylor series sum_n z^n / (n+4)!, and the recursion is evaluated downwards: phi_k = z phi_{k+1} + 1/k!.
Source: Hochbruck, Ostermann, Exponential integrators, Acta Numerica 19 (2010), section 2.
"""

from math import exp, expm1

from numba import njit

_SWITCH = -2.0  # below it the upward recursion loses < 2 digits; above it the series reaches 1e-17


@njit(cache=True, error_model="numpy")
def phi_functions(z: float) -> tuple[float, float, float, float, float]:
    """(phi_0, ..., phi_4) at z <= 0, relative error below 1e-14."""
    if z < _SWITCH:
        p1 = expm1(z) / z
        p2 = (p1 - 1.0) / z
        p3 = (p2 - 0.5) / z
        p4 = (p3 - 1.0 / 6.0) / z
        return exp(z), p1, p2, p3, p4
    p4, most = 0.0, 11 if z > -0.02 else 15 if z > -0.25 else 27  # terms above rounding
    for n in range(most, 4, -1):  # Horner: 1/4! (1 + z/5 (1 + z/6 (...)))
        p4 = (p4 + 1.0) * z / n
    p4 = (p4 + 1.0) / 24.0
    p3 = z * p4 + 1.0 / 6.0
    p2 = z * p3 + 0.5
    p1 = z * p2 + 1.0
    return z * p1 + 1.0, p1, p2, p3, p4
