"""Bases of spring laws against their closed forms, by numpy's polynomials and by finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Legendre, Polynomial
from via_estimators.basis import BASES, fill_basis, swing_before, swing_of_last

SLOPES = {
    "powers": lambda j: Polynomial.basis(j),
    "odd_powers": lambda j: Polynomial.basis(2 * j),
    "legendre": lambda j: Legendre.basis(j),
    "odd_legendre": lambda j: Legendre.basis(2 * j),
}


def filled(name, phi, scale, terms):
    f, g, bend = np.empty(terms), np.empty(terms), np.empty(terms)
    fill_basis(BASES[name], phi, scale, f, g, bend)
    return f, g, bend


@pytest.mark.parametrize("name", BASES)
@settings(deadline=None)
@given(phi=st.floats(-2.0, 2.0), scale=st.floats(0.1, 3.0), terms=st.integers(1, 8))
def test_terms_and_slopes_are_the_polynomials_named(name, phi, scale, terms):
    f, g, bend = filled(name, phi, scale, terms)
    for j in range(terms):
        slope = SLOPES[name](j)
        size = max(1.0, np.abs(slope(np.array([1.0, phi / scale]))).max())
        assert g[j] == pytest.approx(slope(phi / scale), rel=1e-9, abs=1e-9 * size)
        assert f[j] == pytest.approx(scale * slope.integ(lbnd=0)(phi / scale), rel=1e-9, abs=1e-9 * scale * size)
        curve = slope.deriv()(phi / scale) / scale
        assert bend[j] == pytest.approx(curve, rel=1e-9, abs=1e-8 * size / scale)


@pytest.mark.parametrize("name", BASES)
def test_no_term_is_a_constant(name):
    """Errata, after (37): the printed f_1 = phi^0 has no slope, so no coefficient of it is a stiffness."""
    f, g, _ = filled(name, 0.0, 0.7, 6)
    assert np.array_equal(f, np.zeros(6))
    assert g[0] == 1.0
    printed = [Polynomial.basis(i - 1) for i in range(1, 4)]
    assert printed[0](0.0) == 1.0 and printed[0].deriv()(0.3) == 0.0
    # m = 3 as printed reaches phi^2 at most: the cubic spring law of eq. (35) is outside its span
    phi = np.linspace(-1.0, 1.0, 41)
    powers = np.stack([p(phi) for p in printed], axis=1)
    left = 10.0 * phi**3 - powers @ np.linalg.lstsq(powers, 10.0 * phi**3, rcond=None)[0]
    assert np.abs(left).max() > 1.0
    ours = np.stack([filled("powers", x, 1.0, 3)[0] for x in phi])
    assert np.abs(10.0 * phi**3 - ours @ np.linalg.lstsq(ours, 10.0 * phi**3, rcond=None)[0]).max() < 1e-12


@pytest.mark.parametrize(("first", "second"), [("powers", "legendre"), ("odd_powers", "odd_legendre")])
def test_legendre_spans_what_powers_span_and_is_better_conditioned(first, second):
    phi = np.linspace(-0.8, 0.8, 101)
    slopes = {name: np.stack([filled(name, x, 0.8, 5)[1] for x in phi]) for name in (first, second)}
    both = np.hstack(list(slopes.values()))
    assert np.linalg.matrix_rank(both, tol=1e-9) == 5
    assert np.linalg.cond(slopes[second]) < 0.2 * np.linalg.cond(slopes[first])


@pytest.mark.parametrize("name", BASES)
@pytest.mark.parametrize("back", [0, 1])
def test_swing_of_the_last_term_is_its_chebyshev_coefficient(name, back):
    """Chebyshev: of all polynomials with that leading coefficient the smallest has this size."""
    terms, far = 5, 0.8
    z = far * np.cos(np.pi * (np.arange(400) + 0.5) / 400)
    slope = SLOPES[name](terms - 1 - back)
    degree = slope.degree()
    chebyshev = np.polynomial.chebyshev.Chebyshev.fit(z, slope(z), degree, domain=[-far, far])
    size = swing_of_last(BASES[name], terms, back, far)
    assert size == pytest.approx(abs(chebyshev.coef[degree]), rel=1e-9)
    for steps in (1, 2):
        held = chebyshev.coef[degree - 2 * steps] / chebyshev.coef[degree] if degree >= 2 * steps else 0.0
        assert swing_before(BASES[name], terms, back, far, steps) == pytest.approx(held, rel=1e-6, abs=1e-9)
