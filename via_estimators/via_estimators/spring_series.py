"""Spring laws as power series, shared by the estimators whose unknowns are its coefficients.

    tau_e(phi) = sum_p a_p f_p(phi),   f_p = s (phi/s)^p / p,  f_0 = s,   sigma(phi) = sum_p a_p (phi/s)^(p-1)

a_p [N m/rad] is in units of stiffness at the deflection scale s. Powers are odd, p = 1, 3, ..; a spring law that is not
odd (springs pretensioned against each other) also needs 0, 2, 4, ..
"""

from __future__ import annotations

import numpy as np
from numba import njit
from via_core.springs import SpringLaw

MOST_TERMS = 6
LEAST_TERMS = 3  # a spring whose file says linear may be cubic, and one more term shows that the series ends there


def terms_for(springs: tuple[SpringLaw, ...]) -> tuple[int, int]:
    """Numbers of odd and even terms that fit the spring laws to 1 % of their largest torque, plus one each.

    There are at least LEAST_TERMS odd ones.

    The constant is always there: the zeros of two encoders and of a torque differ by a few steps at least, and a stiff
    spring answers with a torque that other terms, or friction that builds up with travel, would have to explain.
    """
    share = np.linspace(-1.0, 1.0, 129)
    torques = np.stack([each.torque(share * each.max_deflection) for each in springs], axis=1)
    largest = np.abs(torques).max()
    odd = np.abs(torques + torques[::-1]).max() <= 1e-6 * largest
    for order in range(1, MOST_TERMS):
        terms = share[:, None] ** (2 * np.arange(order) + 1 if odd else np.arange(2 * order))
        misfit = torques - terms @ np.linalg.lstsq(terms, torques, rcond=None)[0]
        if np.abs(misfit).max() <= 0.01 * largest:
            return max(order + 1, LEAST_TERMS), 1 if odd else order + 1
    return MOST_TERMS, 1 if odd else MOST_TERMS


@njit(cache=True, error_model="numpy")
def power(term: int, order: int) -> int:
    """Power of phi in a term: odd powers first, then even ones from 0."""
    return 2 * term + 1 if term < order else 2 * (term - order)


@njit(cache=True, error_model="numpy")
def tail(n: int, far: float, share: float, variance: float) -> float:
    """Squared stiffness [(N m/rad)^2] of the terms left out, bounded by the size of the last term without its noise.

    Over the deflections visited, |phi| <= far s, a power n of phi contains 2^(1-n) far^n of the Chebyshev polynomial
    T_n, and the Chebyshev coefficients of a smooth function decrease.

    n                power of phi in the last term's stiffness
    share, variance  its coefficient [N m/rad] and that number's variance
    """
    size = 2.0 ** (1 - n) * far**n if n > 0 else 0.0
    return size * size * max(share * share - 4.0 * variance, 0.0)
