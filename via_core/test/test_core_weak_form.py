"""Weak form: closed forms, integration by parts, convergence, jittered stamps, and the document's misprints."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from via_core.errors import ParameterError
from via_core.weak_form import fill_third, fill_weights, modulating, window_weights

ORDERS = pytest.mark.parametrize("h", [3, 5])
RNG_SEED = 11


def w(i: int, j: int) -> np.polynomial.Polynomial:
    """w_ij of eq. (13) as a polynomial: the slow obvious version."""
    return np.polynomial.Polynomial([1.0, -1.0]) ** i * np.polynomial.Polynomial([0.0, 1.0]) ** j


def jittered(n: int, span: float = 0.2, jitter: float = 0.3, seed: int = RNG_SEED) -> np.ndarray:
    stamps = np.linspace(0.0, span, n)
    stamps[1:-1] += jitter * span / (n - 1) * np.random.default_rng(seed).uniform(-1.0, 1.0, n - 2)
    return stamps


def inner(h: int, derivative: int, stamps: np.ndarray, f) -> float:
    """<f, psi^(i)> by Gauss-Legendre quadrature: exact for what the tests use."""
    span = stamps[-1] - stamps[0]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    u = 0.5 * (nodes + 1.0)
    psi = factorial(2 * h + 1) / factorial(h) ** 2 * modulating(h, derivative, u) / span ** (derivative + 1)
    return float(0.5 * span * np.sum(weights * psi * f(stamps[0] + span * u)))


def trapezoid(h: int, derivative: int, stamps: np.ndarray) -> np.ndarray:
    """Plain trapezoid weights on the stamps, nothing corrected: the slow obvious version."""
    span = stamps[-1] - stamps[0]
    psi = factorial(2 * h + 1) / factorial(h) ** 2 * modulating(h, derivative, (stamps - stamps[0]) / span)
    steps = np.concatenate([[0.0], np.diff(stamps), [0.0]])
    return psi / span ** (derivative + 1) * 0.5 * (steps[1:] + steps[:-1])


def swing(t):
    return 1.3 + np.sin(9.0 * t + 0.4)


def same_to_rounding(ours, others) -> None:
    """Rows (k, n) equal but for the order in which sums were taken, which is that of storage."""
    assert np.all(np.abs(ours - others) <= 1e-14 * np.abs(others).max(axis=1, keepdims=True))


@pytest.mark.parametrize("h", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("derivative", [0, 1, 2, 3, 4, 5, 6])
def test_modulating_function_and_derivatives_equal_the_polynomial(h: int, derivative: int) -> None:
    u = np.linspace(0.0, 1.0, 23)
    np.testing.assert_allclose(modulating(h, derivative, u), w(h, h).deriv(derivative)(u), atol=2e-9)
    assert modulating(h, derivative, [-0.1, 1.1]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("h", [1, 2, 3, 4, 5])
def test_w_hh_has_order_h_and_not_h_plus_one(h: int) -> None:
    """Example 1 prints h + 1; definition 1 wants the derivatives 0..order-1 to vanish at both ends."""
    ends = np.array([0.0, 1.0])
    for i in range(h):
        np.testing.assert_array_equal(modulating(h, i, ends), [0.0, 0.0])
    np.testing.assert_allclose(modulating(h, h, ends), [factorial(h), (-1) ** h * factorial(h)])


def test_order_three_is_enough_for_three_derivatives() -> None:
    """<f''', psi> = -<f, psi'''> with w_33, although 'h = 4' is printed; w_22 is not enough."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    u, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    f, third = np.exp(1.7 * u), 1.7**3 * np.exp(1.7 * u)
    assert np.sum(weights * third * modulating(3, 0, u)) == pytest.approx(-np.sum(weights * f * modulating(3, 3, u)))
    assert np.sum(weights * third * modulating(2, 0, u)) != pytest.approx(
        -np.sum(weights * f * modulating(2, 3, u)), rel=0.1
    )


def test_printed_equation_30_has_the_wrong_sign_of_its_first_term() -> None:
    u = np.linspace(0.0, 1.0, 11)
    right = (-6.0 * w(0, 3) + 54.0 * w(1, 2) - 54.0 * w(2, 1) + 6.0 * w(3, 0))(u)
    printed = (+6.0 * w(0, 3) + 54.0 * w(1, 2) - 54.0 * w(2, 1) + 6.0 * w(3, 0))(u)
    np.testing.assert_allclose(modulating(3, 3, u), right, atol=1e-12)
    assert np.max(np.abs(modulating(3, 3, u) - printed)) == pytest.approx(12.0)
    # how it would show: a constant encoder offset must not reach an estimate
    fine = np.linspace(0.0, 1.0, 2001)
    assert np.trapezoid(modulating(3, 3, fine), fine) == pytest.approx(0.0, abs=1e-5)
    wrong = (+6.0 * w(0, 3) + 54.0 * w(1, 2) - 54.0 * w(2, 1) + 6.0 * w(3, 0))(fine)
    assert np.trapezoid(wrong, fine) == pytest.approx(3.0, abs=1e-5)


def test_equations_28_and_29_are_right() -> None:
    u = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(modulating(3, 1, u), (-3.0 * w(2, 3) + 3.0 * w(3, 2))(u), atol=1e-12)
    np.testing.assert_allclose(modulating(3, 2, u), (6.0 * w(1, 3) - 18.0 * w(2, 2) + 6.0 * w(3, 1))(u), atol=1e-12)


@ORDERS
@pytest.mark.parametrize("stamps", [np.linspace(3.0, 3.2, 201), 3.0 + jittered(51)], ids=["uniform", "jittered"])
def test_rows_are_exact_for_polynomials_up_to_their_degree(h: int, stamps: np.ndarray) -> None:
    rows = window_weights(h, stamps)
    middle = 0.5 * (stamps[0] + stamps[-1])
    for row, weights in enumerate(rows):
        for degree in range(row + 1):
            expected = (-1.0) ** row * factorial(row) if degree == row else 0.0
            scale = np.sum(np.abs(weights * (stamps - middle) ** degree))
            assert np.sum(weights * (stamps - middle) ** degree) == pytest.approx(expected, abs=1e-12 * scale + 1e-12)


@ORDERS
def test_an_encoder_offset_moves_no_derivative_on_jittered_stamps(h: int) -> None:
    stamps = jittered(101)
    rows = window_weights(h, stamps)
    f = swing(stamps)
    for row in (1, 2):
        # ten radians more: nothing but rounding of sums of size 10 |W|
        change = rows[row] @ (f + 10.0) - rows[row] @ f
        assert abs(change) < 1e-12 * np.sum(np.abs(rows[row])) * 10.0
        assert abs(10.0 * np.sum(trapezoid(h, row, stamps))) > 1e6 * abs(change)  # plain trapezoids let it through


@ORDERS
@pytest.mark.parametrize("row", [0, 1, 2])
def test_order_of_convergence_on_uniform_stamps(h: int, row: int) -> None:
    """Euler-Maclaurin: the error falls like H^-(m + 1), m the first odd number >= h - i."""
    errors = []
    sizes = (24, 48)
    for size in sizes:
        stamps = np.linspace(0.0, 0.4, size + 1)
        errors.append(abs(window_weights(h, stamps)[row] @ swing(stamps) - inner(h, row, stamps, swing)))
    order = np.log2(errors[0] / errors[1])
    m = h - row if (h - row) % 2 else h - row + 1
    assert order == pytest.approx(m + 1, abs=0.35)


@ORDERS
def test_integration_by_parts(h: int) -> None:
    """<f', psi> = -<f, psi'> and <f'', psi> = <f, psi''>: derivatives move from the signal to the weights."""
    stamps = np.linspace(0.0, 0.2, 201)
    rows = window_weights(h, stamps)
    f, rate, bend = swing(stamps), 9.0 * np.cos(9.0 * stamps + 0.4), -81.0 * np.sin(9.0 * stamps + 0.4)
    assert rows[0] @ rate == pytest.approx(-rows[1] @ f, rel=1e-7)
    assert rows[0] @ bend == pytest.approx(rows[2] @ f, rel=1e-4)


@ORDERS
@given(shift=st.floats(-1e3, 1e3), stretch=st.floats(0.1, 10.0))
def test_only_differences_of_stamps_count(h: int, shift: float, stretch: float) -> None:
    stamps = jittered(41)
    rows = window_weights(h, stamps)
    moved = window_weights(h, stretch * stamps + shift)
    # a shift by 1000 s costs the stamps 1e-13 s each, the second row divides by steps squared
    for row in range(3):
        size = np.max(np.abs(rows[row]))
        np.testing.assert_allclose(moved[row] * stretch**row, rows[row], atol=2e-7 * size)


@ORDERS
def test_jittered_stamps_beat_the_belief_that_they_are_uniform(h: int) -> None:
    actual, assumed, plain = np.zeros(3), np.zeros(3), np.zeros(3)
    for seed in range(20):
        stamps = jittered(61, jitter=0.3, seed=seed)
        uniform = np.linspace(stamps[0], stamps[-1], len(stamps))
        for row in range(3):
            truth = inner(h, row, stamps, swing)
            actual[row] += (window_weights(h, stamps)[row] @ swing(stamps) - truth) ** 2
            assumed[row] += (window_weights(h, uniform)[row] @ swing(stamps) - truth) ** 2
            plain[row] += (trapezoid(h, row, stamps) @ swing(stamps) - truth) ** 2
    assert np.all(np.sqrt(actual) < 0.1 * np.sqrt(assumed))
    assert np.all(np.sqrt(actual) < 0.5 * np.sqrt(plain))  # and the correction beats plain trapezoids on them


@ORDERS
def test_uniform_rows_agree_with_plain_trapezoids(h: int) -> None:
    stamps = np.linspace(1.0, 1.2, 401)
    rows = window_weights(h, stamps)
    for row in range(3):
        plain = trapezoid(h, row, stamps)
        np.testing.assert_allclose(rows[row], plain, atol=1e-3 * np.max(np.abs(plain)))


@ORDERS
@given(first=st.integers(0, 40))
def test_a_ring_buffer_gives_the_same_weights_in_its_own_order(h: int, first: int) -> None:
    stamps = jittered(41)
    rows = window_weights(h, stamps)
    ring = np.empty((3, 41))
    fill_weights(h, np.roll(stamps, first), first, ring)
    same_to_rounding(np.roll(ring, -first, axis=1), rows)


@ORDERS
def test_the_newest_sample_is_at_u_one(h: int) -> None:
    """Eqs. (26), (27) pair sample k - m with the weight at m/H: backwards, which flips the sign of <f, psi'>."""
    stamps = np.linspace(0.0, 0.2, 101)
    rising = stamps - 0.1  # f' = 1, so <f, psi'> must be -1
    first = window_weights(h, stamps)[1]
    assert first @ rising == pytest.approx(-1.0)
    assert first[::-1] @ rising == pytest.approx(1.0)


def test_motor_equation_holds_in_weak_form() -> None:
    """B <theta, psi''> - D <theta, psi'> - <tau_e, psi> = <tau, psi> for a planted motion."""
    B, D, c = 0.01, 0.1, 10.0
    stamps = jittered(201, jitter=0.2)
    theta, rate, bend = swing(stamps), 9.0 * np.cos(9.0 * stamps + 0.4), -81.0 * np.sin(9.0 * stamps + 0.4)
    tau_e = c * (0.2 - theta) ** 3
    tau = B * bend + D * rate - tau_e
    psi, psi1, psi2 = window_weights(5, stamps)
    assert B * psi2 @ theta - D * psi1 @ theta - psi @ tau_e == pytest.approx(psi @ tau, rel=1e-5)


def test_noise_gain_matches_the_continuous_kernel() -> None:
    """White noise on f: var <f, psi'> = s^2 sum W^2 -> s^2 Ts integral psi'^2, here in closed form for w_33."""
    stamps = np.linspace(0.0, 0.2, 401)
    c = factorial(7) / factorial(3) ** 2
    integral = (c**2 * (w(3, 3).deriv() ** 2).integ())(1.0) / 0.2**3
    assert np.sum(window_weights(3, stamps)[1] ** 2) == pytest.approx(0.2 / 400 * integral, rel=1e-3)


@pytest.mark.parametrize(
    ("h", "stamps", "message"),
    [
        (1, np.arange(10.0), "order must be >= 2"),
        (3, np.arange(4.0), "at least 5 stamps"),
        (3, np.zeros((5, 5)), "at least 5 stamps"),
        (3, [0.0, 1.0, 1.0, 2.0, 3.0], "strictly increasing"),
        (3, [0.0, 1.0, np.nan, 2.0, 3.0], "finite"),
    ],
)
def test_invalid_windows_are_refused(h: int, stamps, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        window_weights(h, stamps)


def test_negative_orders_are_refused() -> None:
    with pytest.raises(ParameterError, match="order and derivative must be >= 0"):
        modulating(-1, 0, 0.5)
    with pytest.raises(ParameterError, match="order and derivative must be >= 0"):
        modulating(3, -1, 0.5)


def test_the_smallest_window_is_still_exact() -> None:
    stamps = np.array([0.0, 0.1, 0.25, 0.3, 0.5])
    rows = window_weights(3, stamps)
    np.testing.assert_allclose([rows[0].sum(), rows[1] @ stamps, rows[2] @ stamps**2], [1.0, -1.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize("h", [3, 4, 5, 7])
@pytest.mark.parametrize("stamps", [np.linspace(3.0, 3.2, 201), 3.0 + jittered(51)], ids=["uniform", "jittered"])
def test_the_third_row_is_exact_for_cubic_polynomials(h: int, stamps: np.ndarray) -> None:
    third = window_weights(h, stamps, 4)[3]
    x = stamps - 0.5 * (stamps[0] + stamps[-1])
    for degree, expected in enumerate([0.0, 0.0, 0.0, -6.0]):
        assert np.sum(third * x**degree) == pytest.approx(
            expected, abs=1e-12 * np.sum(np.abs(third * x**degree)) + 1e-9
        )


@pytest.mark.parametrize("h", [3, 4, 5])
def test_the_third_row_beats_plain_trapezoids_although_w_33_does_not_vanish_at_the_ends(h: int) -> None:
    """Uniform stamps keep the order H^-2 (h = 3, 4), H^-4 (h = 5), with 7 to 30 times less error; jittered ones too."""
    sizes, ours, plain = (48, 96), [], []
    for size in sizes:
        stamps = np.linspace(0.0, 0.4, size + 1)
        truth = inner(h, 3, stamps, swing)
        ours.append(abs(window_weights(h, stamps, 4)[3] @ swing(stamps) - truth))
        plain.append(abs(trapezoid(h, 3, stamps) @ swing(stamps) - truth))
    assert np.log2(ours[0] / ours[1]) == pytest.approx(2.0 if h < 5 else 4.0, abs=0.2)
    assert plain[0] > 5.0 * ours[0] and plain[1] > 5.0 * ours[1]
    errors = np.zeros(2)
    for seed in range(20):
        stamps = jittered(97, 0.4, seed=seed)
        truth = inner(h, 3, stamps, swing)
        errors += np.square(
            [row @ swing(stamps) - truth for row in (window_weights(h, stamps, 4)[3], trapezoid(h, 3, stamps))]
        )
    assert np.sqrt(errors[0]) < 0.5 * np.sqrt(errors[1])


@given(first=st.integers(0, 40))
def test_the_third_row_in_a_ring_buffer_is_the_same_and_leaves_the_others(first: int) -> None:
    stamps, ring = jittered(41), np.empty((4, 41))
    rows = window_weights(3, stamps, 4)
    np.testing.assert_array_equal(rows[:3], window_weights(3, stamps))
    fill_weights(3, np.roll(stamps, first), first, ring)
    fill_third(3, np.roll(stamps, first), first, ring)
    same_to_rounding(np.roll(ring, -first, axis=1), rows)


def test_ten_radians_more_move_no_third_derivative_unless_equation_30_is_used_as_printed() -> None:
    stamps = np.linspace(0.0, 0.5, 501)
    third = window_weights(3, stamps, 4)[3]
    assert abs(third @ (swing(stamps) + 10.0) - third @ swing(stamps)) < 1e-12 * 10.0 * np.sum(np.abs(third))
    u = stamps / 0.5
    printed = (6.0 * w(0, 3) + 54.0 * w(1, 2) - 54.0 * w(2, 1) + 6.0 * w(3, 0))(u) / 500 * 140.0 / 0.5**3
    assert abs(10.0 * printed.sum()) > 50.0 * abs(third @ swing(stamps))  # 10 rad weigh more than all the motion


def test_proposition_1_holds_up_to_i_equal_to_h_and_no_further() -> None:
    """Printed 'i = 0..k-1'; right: i = 0..h."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    u, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    for h in (2, 3, 5):
        for i in range(h + 2):
            left = np.sum(weights * 1.7**i * np.exp(1.7 * u) * modulating(h, 0, u))
            right = (-1.0) ** i * np.sum(weights * np.exp(1.7 * u) * modulating(h, i, u))
            assert (left == pytest.approx(right, rel=1e-6)) == (i <= h)


def test_equation_24_as_printed_is_the_integral_over_seconds_and_shrinks_by_the_window() -> None:
    """W_m = T_s, t_m = m T_s belong to [0, T]; on [0, 1] it is 1/H. The printed form scales each row by T, P(0) not."""
    span, size = 0.5, 500
    u = np.arange(size + 1) / size
    halved = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0)
    f = swing(span * u)
    truth = inner(3, 1, span * u, swing) * span / 140.0
    assert np.sum(halved / size * f * modulating(3, 1, u)) == pytest.approx(truth, rel=1e-5)
    assert np.sum(halved * span / size * f * modulating(3, 1, u)) == pytest.approx(span * truth, rel=1e-5)


@pytest.mark.parametrize("h", [3, 5])
def test_samples_k_minus_m_flip_the_odd_rows_and_only_them(h: int) -> None:
    """(26), (27) pair sample k - m with weight m/H: psi' and psi''' change sign, psi'' does not, so only D is hit."""
    rows = window_weights(h, np.linspace(0.0, 0.5, 101), 4)
    for row, sign in ((1, -1.0), (2, 1.0), (3, -1.0)):
        np.testing.assert_allclose(rows[row][::-1], sign * rows[row], atol=1e-9 * np.abs(rows[row]).max())


def test_invalid_rows_are_refused() -> None:
    with pytest.raises(ParameterError, match="order must be >= 3"):
        window_weights(2, np.arange(10.0), 4)
    with pytest.raises(ParameterError, match="rows must be 3 or 4, got 5"):
        window_weights(5, np.arange(10.0), 5)
