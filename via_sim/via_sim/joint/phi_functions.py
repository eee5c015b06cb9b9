"""phi functions of exponential integrators: phi_0 = exp(z), phi_k(z) = int_0^1 exp((1-s) z) s^(k-1) / (k-1)! ds.

The recursion phi_{k+1}(z) = (phi_k(z) - 1/k!) / z suffers from cancellation near z = 0. There phi_4 is summed as its
Taylor series sum_n z^n / (n+4)!, and the recursion is evaluated downwards: phi_k = z phi_{k+1} + 1/k!.
Source: Hochbruck, Ostermann, Exponential integrators, Acta Numerica 19 (2010), section 2.
"""

from math import exp, expm1, factorial
from typing import Any

import numpy as np

from via_sim.joint.compiled import bare, inlined

_SWITCH = -2.0  # below it the upward recursion loses < 2 digits; above it the series reaches 1e-17

SHORT_SERIES, SHORT_REACH = 15, 0.25  # further terms are below rounding
_INVERSE_FACTORIALS = np.array([1.0 / factorial(n) for n in range(28)])


@bare
def phi_functions(z: float) -> tuple[float, float, float, float, float]:
    """(phi_0, ..., phi_4) at z <= 0, relative error below 1e-14."""
    if z < _SWITCH:
        p1 = expm1(z) / z
        p2 = (p1 - 1.0) / z
        p3 = (p2 - 0.5) / z
        p4 = (p3 - 1.0 / 6.0) / z
        return exp(z), p1, p2, p3, p4
    return phi_series(z, 11 if z > -0.02 else SHORT_SERIES if z > -SHORT_REACH else 27)


@inlined
def phi_series(z: Any, most: int) -> tuple[Any, Any, Any, Any, Any]:
    """(phi_0, ..., phi_4) at z <= 0 from terms up to z^(most - 4); SHORT_SERIES is exact above -SHORT_REACH."""
    p4 = 0.0 * z
    for n in range(most, 3, -1):
        p4 = p4 * z + _INVERSE_FACTORIALS[n]
    p3 = z * p4 + 1.0 / 6.0
    p2 = z * p3 + 0.5
    p1 = z * p2 + 1.0
    return z * p1 + 1.0, p1, p2, p3, p4
