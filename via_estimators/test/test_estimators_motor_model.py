"""Process model of the Kalman filters: exponential factors, time step and derivatives, each against another method."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from via_estimators import motor_model
from via_estimators.motor_model import X


def model_of(order=2, scale=1.0, inertia=0.02, friction_velocity=0.05):
    return np.array([order, scale, inertia, friction_velocity])


def state(angle, velocity, inverse=1.0, damping=0.3, friction=0.1, coefficients=(8.0, 15.0)):
    """x (n,): divided by the inertia, `inverse` = B_0/B times the physical parameters."""
    return np.array([angle, velocity, inverse, *(inverse * np.array([damping, friction, *coefficients]))])


def advanced(model, x, given):
    return np.array(motor_model.advance(model, x, np.array(given), np.empty((4, len(x)))))


@pytest.mark.parametrize("rate", [0.0, 1e-6, 1.0, 11.0, 499.0, 501.0, 12700.0])
def test_factors_are_those_of_the_matrix_exponential(rate):
    h = 1e-3
    found, above, below = np.empty(6), np.empty(6), np.empty(6)
    motor_model.factors(rate, h, found)
    exact = expm(h * np.array([[0.0, 1.0, 0.0], [0.0, -rate, 1.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found[:3], [exact[1, 1], exact[0, 1], exact[0, 2]], rtol=1e-12, atol=1e-300)
    motor_model.factors(rate + 0.5, h, above)
    motor_model.factors(rate - 0.5, h, below)
    np.testing.assert_allclose(found[3:], (above - below)[:3], rtol=1e-5)


@pytest.mark.parametrize(
    ("inertia", "damping", "friction", "coefficients"),
    [(0.02, 0.3, 0.1, (8.0, 15.0)), (1e-4, 1.27, 0.0, (0.0, 30.0)), (0.0233, 0.27, 0.02, (80.0, 400.0))],
)
def test_steps_follow_the_differential_equation(inertia, damping, friction, coefficients):
    """100 steps of 1 ms from rest, against Radau; the second case is as stiff as cubic_aa_vsa (12700 1/s)."""
    T, model = 1e-3, model_of(inertia=inertia)
    q = 0.5 * np.sin(9.0 * T * np.arange(101)) - 0.2
    torque = 0.4 * np.sin(25.0 * T * np.arange(101))

    def rates(t, y, k):
        phi = q[k] + (q[k + 1] - q[k]) * (t / T - k) - y[0]
        pull = coefficients[0] * phi + coefficients[1] * phi**3 / 3.0
        return [y[1], (torque[k + 1] + pull - damping * y[1] - friction * y[1] / np.hypot(y[1], 0.05)) / inertia]

    x, y, moved, missed = state(0.0, 0.0, 1.0, damping, friction, coefficients), np.zeros(2), [], []
    for k in range(100):
        x[:2] = advanced(model, x, [T, q[k], q[k + 1], torque[k + 1]])
        y = solve_ivp(rates, (T * k, T * (k + 1)), y, "Radau", args=(k,), rtol=1e-7, atol=1e-9).y[:, -1]
        moved.append(y[0])
        missed.append(x[0] - y[0])
    assert np.ptp(moved) > 0.02
    assert np.abs(missed).max() < 1e-3 * np.ptp(moved)


def test_the_inertia_divides_all_other_parameters():
    """B = B_0/.8 with everything else as before is the model of another B_0."""
    given = [2e-3, 0.3, 0.31, 0.7]
    found = advanced(model_of(inertia=0.02), state(0.1, 0.4, 0.8), given)
    np.testing.assert_allclose(found, advanced(model_of(inertia=0.025), state(0.1, 0.4), given), rtol=1e-12)


@pytest.mark.parametrize(("order", "even"), [(1, 0), (3, 0), (2, 3)])
@pytest.mark.parametrize("signs", [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)])
@pytest.mark.parametrize("inertia", [0.02, 1e-4])
def test_derivatives_equal_finite_differences(order, even, signs, inertia):
    rng = np.random.default_rng(order + even)
    model, given = model_of(order, 0.8, inertia), np.array([1e-3, 0.5, 0.52, 0.7])
    x = np.array([0.1, 0.06, 0.9, 0.3 * signs[0], 0.1 * signs[1], *rng.normal(0.0, 5.0, order + even)])
    work, found = np.empty((4, len(x))), np.empty((2, len(x)))
    assert np.array_equal(motor_model.derivatives(model, x, given, work, found), advanced(model, x, given))
    for j in range(len(x)):
        step = np.zeros(len(x))
        step[j] = 1e-5
        slope = (advanced(model, x + step, given) - advanced(model, x - step, given)) / 2e-5
        np.testing.assert_allclose(found[:, j], slope, rtol=1e-5, atol=1e-9 * np.abs(found).max())


def test_bend_is_the_derivative_of_stiffness():
    model, x, f, g = (
        model_of(2, 0.8),
        state(0.0, 0.0, coefficients=(8.0, 15.0, 0.5, 2.0, -3.0)),
        np.empty(5),
        np.empty(5),
    )
    for phi in (-0.3, 0.2):
        low, high = (motor_model.spring(model, x, phi + d, f, g) for d in (-1e-6, 1e-6))
        assert (high[0] - low[0]) / 2e-6 == pytest.approx(motor_model.spring(model, x, phi, f, g)[1], rel=1e-7)
        assert (high[1] - low[1]) / 2e-6 == pytest.approx(motor_model.bend(model, x, phi), rel=1e-6)


def test_the_walk_of_parameters_ends_at_the_prior():
    x, P, widths = state(0.1, 0.2), np.zeros((7, 7)), np.full(7, 0.5)
    motor_model.drift(x, P, 4.0, 0.01, 0.002, widths)
    np.testing.assert_allclose(P[5:, 5:], 4e-4 * np.outer(x[5:], x[5:]))
    assert P[X.damping, X.damping] == pytest.approx((0.004 * 0.3) ** 2)
    assert not P[:2].any()
    for _ in range(100):
        motor_model.drift(x, P, 1e4, 0.01, 0.002, widths)
    assert np.all(np.diag(P)[2:5] < 0.5**2 + 1e4 * (0.002 * x[2:5]) ** 2)
