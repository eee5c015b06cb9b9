"""Section 7: the closed form against the equation of motion, quadrature and co-states."""

from itertools import pairwise
from math import acos, inf, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, simpson, solve_ivp
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_core.errors import ParameterError

OMEGA = 3.0  # [rad/s]
RATIOS = (0.0, 1e-9, 0.1, 0.4, 0.9, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.5, 20.0)


def beyond(joint: ViscoElasticJoint, swings: float) -> float:
    """A horizon [s] this many half swings after the first reversal."""
    return joint.first_turn + swings * min(joint.between_turns, 2.0)


@pytest.mark.parametrize("D", RATIOS)
def test_response_agrees_with_the_equation_of_motion(D):
    """A step of motor velocity, integrated slowly: qd is the integral of g, for every damping."""
    joint = ViscoElasticJoint(OMEGA, D)

    def right_hand_side(t, x):
        return [1.0 - x[1], OMEGA**2 * x[0] + 2.0 * D * OMEGA * (1.0 - x[1])]

    times = np.linspace(0.0, 3.0, 31)
    slow = solve_ivp(right_hand_side, (0.0, 3.0), [0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12, method="LSODA").y[1]
    assert joint.step_response(times) == pytest.approx(slow, abs=2e-8)
    middle = 0.5 * (times[1:] + times[:-1])
    slopes = (joint.step_response(middle + 1e-5) - joint.step_response(middle - 1e-5)) / 2e-5
    assert joint.response(middle) == pytest.approx(slopes, abs=1e-6)


@settings(deadline=None)
@given(st.floats(0.0, 3.0), st.floats(0.05, 4.0))
def test_fastest_is_the_integral_of_the_response_size(D, swings):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = beyond(joint, swings)
    ends = [0.0, *(horizon - joint.turns(horizon))[::-1], horizon]
    slow = sum(
        abs(quad(lambda t: float(joint.response(t)), a, b, epsabs=1e-13, epsrel=1e-13)[0]) for a, b in pairwise(ends)
    )
    assert joint.fastest(horizon) == pytest.approx(slow, rel=1e-9)


@pytest.mark.parametrize("D", [0.0, 0.3, 1.5])
def test_125_holds_with_the_co_states_that_end_at_t_f(D):
    """sigma* is printed as a combination of co-states without details: those of (124), counted back from the end.

    For any motion of the motor. Read as the response since the start, or as co-states of qd(t_f) instead of
    J = -qd(t_f), (125) is wrong.
    """
    joint, horizon = ViscoElasticJoint(OMEGA, D), 2.0
    spring, damper = OMEGA**2, 2.0 * D * OMEGA
    A, b = np.array([[0.0, -1.0], [spring, -damper]]), np.array([1.0, damper])  # of (theta - q, qd), driven by thetad
    xi = np.linspace(0.0, horizon, 4001)
    end = np.array([0.0, -1.0])  # gradient of J at t_f
    costates = solve_ivp(
        lambda _, costate: -A.T @ costate, (horizon, 0.0), end, t_eval=xi[::-1], rtol=1e-10, atol=1e-12, method="LSODA"
    ).y[:, ::-1]
    sigma = b @ costates
    assert -joint.response(horizon - xi) == pytest.approx(sigma, abs=1e-6)

    def motor(time):
        return 0.7 + np.sin(5.0 * time) - 0.4 * time**2

    link = solve_ivp(lambda t, x: A @ x + b * motor(t), (0.0, horizon), [0.0, 0.0], rtol=1e-10, atol=1e-12).y[1, -1]

    def by_125(switching):
        return -simpson(switching * motor(xi), x=xi)

    assert by_125(sigma) == pytest.approx(link, abs=1e-7)
    for wrong in (-joint.response(xi), b @ -costates):
        assert abs(by_125(wrong) - link) > 0.1 * abs(link)


def test_reversals_are_half_a_damped_period_apart():
    joint = ViscoElasticJoint(OMEGA, 0.2)
    first, second = joint.turns(beyond(joint, 1.5))
    assert second - first == pytest.approx(pi / (OMEGA * sin(acos(0.2))), rel=1e-12)


@pytest.mark.parametrize("wrong", [(0.0, 0.1), (-1.0, 0.1), (inf, 0.1), (1.0, -0.1), (1.0, float("nan"))])
def test_impossible_joints_are_refused(wrong):
    with pytest.raises(ParameterError):
        ViscoElasticJoint(*wrong)
