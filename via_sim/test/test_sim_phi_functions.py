"""phi functions against their Taylor series in exact fractions."""

from fractions import Fraction
from math import factorial

import pytest
from via_sim.joint.phi_functions import phi_functions


def exact(k: int, z: float) -> float:
    """phi_k(z) = sum_n z^n / (n+k)! in rational arithmetic."""
    term, total = Fraction(1, factorial(k)), Fraction(0)
    for n in range(400):
        total += term
        term *= Fraction(z) / (n + 1 + k)
        if n > 80 and abs(term) < Fraction(1, 10**40):
            break
    return float(total)


@pytest.mark.parametrize("z", [0.0, -1e-12, -0.1, -1.0, -1.999999, -2.000001, -12.7, -40.0])
def test_phi_functions_are_exact_to_fourteen_digits(z):
    for k, value in enumerate(phi_functions(z)):
        assert value == pytest.approx(exact(k, z), rel=1e-14)
