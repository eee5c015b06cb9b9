"""Section 7: closed forms of link over motor velocity, a linear program and collocation agree; printed slower forms."""

from math import acos, inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_validation.switching import collocation, program
from via_validation.switching.motor_models import DrivenJoint
from via_validation.switching.performance import bound, performance, velocity_with

OMEGA = 3.0  # [rad/s]
RATIOS = (0.0, 1e-9, 0.1, 0.4, 0.9, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.5, 20.0)


def beyond(joint: ViscoElasticJoint, swings: float) -> float:
    """A horizon [s] this many half swings after the first reversal."""
    return joint.first_turn + swings * min(joint.between_turns, 2.0)


@pytest.mark.parametrize("D", RATIOS)
def test_the_velocity_of_the_best_turns_is_the_fastest(D):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = beyond(joint, 1.7)
    assert velocity_with(joint, joint.turns(horizon), horizon) == pytest.approx(joint.fastest(horizon), rel=1e-9)


def test_performance_has_the_values_of_the_specification():
    assert bound(0.1) == pytest.approx(6.49638, abs=5e-6)
    assert bound(0.4) == pytest.approx(1.97438, abs=5e-6)
    assert performance(2, 0.1) == pytest.approx(3.969098, abs=5e-7)
    assert performance(4, 0.4) == pytest.approx(1.971841, abs=5e-7)
    assert [performance(n, 0.0) for n in range(4)] == pytest.approx([2.0, 4.0, 6.0, 8.0], rel=1e-12)
    assert bound(1.0) == pytest.approx(1.0 + 2.0 * np.exp(-2.0), rel=1e-12)
    assert bound(0.0) == inf


@pytest.mark.parametrize("D", [0.05, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_performance_is_the_fastest_after_n_turns(n, D):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = (2.0 * acos(D) + n * pi) / (OMEGA * sqrt(1.0 - D * D))
    assert performance(n, D) == pytest.approx(joint.fastest(horizon), rel=1e-12)
    assert len(joint.turns(horizon * (1.0 + 1e-9))) == n + 1


@pytest.mark.parametrize("D", [1.0, 1.5, 6.0])
def test_strong_damping_turns_once_and_is_bounded(D):
    joint = ViscoElasticJoint(OMEGA, D)
    assert len(joint.turns(100.0)) == 1
    assert joint.fastest(100.0) == pytest.approx(bound(D), rel=1e-9)
    assert performance(0, D) == pytest.approx(joint.fastest(joint.first_turn), rel=1e-12)


def test_bound_is_continuous_through_critical_damping():
    assert bound(1.0 - 1e-9) == pytest.approx(bound(1.0 + 1e-9), abs=1e-8)


def test_uniform_reversals_as_printed_lose_more_than_a_tenth():
    """'Period of omega_d' is wrong for the last interval: reversals every pi / omega_d lose 15 % at D = .4."""
    joint = ViscoElasticJoint(OMEGA, 0.4)
    horizon = joint.first_turn + 4.0 * joint.between_turns
    uniform = horizon - joint.between_turns * np.arange(1, 5)
    loss = 1.0 - velocity_with(joint, uniform, horizon) / joint.fastest(horizon)
    assert 0.10 < loss < 0.20
    rest = joint.first_turn / joint.between_turns
    assert rest == pytest.approx(2.0 * acos(0.4) / pi, rel=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.floats(0.0, 2.0), st.integers(0, 1000))
def test_no_other_turns_are_faster(D, seed):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = beyond(joint, 2.4)
    turns = np.sort(np.random.default_rng(seed).uniform(0.0, horizon, 3))
    assert abs(velocity_with(joint, turns, horizon)) <= joint.fastest(horizon) + 1e-12


@pytest.mark.parametrize("D", [0.0, 0.1, 0.4, 1.0, 1.5])
def test_linear_program_finds_the_closed_form(D):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = beyond(joint, 1.3)
    found = program.largest_velocity(DrivenJoint(joint, "velocity", 2.0), horizon, steps=40)
    assert found.velocity == pytest.approx(2.0 * joint.fastest(horizon), rel=1e-6)
    turned = found.time[1:-1][np.diff(np.sign(found.control)) != 0]
    expected = joint.turns(horizon)
    # A switch within a step gives this step another height: one of its ends is the nearest node.
    assert all(np.abs(turned - t).min() < 2e-4 * horizon for t in expected)


@pytest.mark.parametrize("D", [0.1, 0.4, 1.5])
def test_collocation_finds_the_closed_form(D):
    joint = ViscoElasticJoint(OMEGA, D)
    horizon = beyond(joint, 1.3)
    found = collocation.largest_velocity(DrivenJoint(joint, "velocity", 2.0), horizon)
    assert found.velocity == pytest.approx(2.0 * joint.fastest(horizon), rel=3e-4)


@pytest.mark.parametrize(
    "driven",
    [
        DrivenJoint(ViscoElasticJoint(OMEGA, 0.3), "acceleration", 20.0, 1.0),
        DrivenJoint(ViscoElasticJoint(OMEGA, 0.3), "torque", 20.0, 1.0, motor_inertia=0.5),
    ],
    ids=lambda driven: driven.drive,
)
def test_programs_agree_and_obey_125_with_every_motor(driven):
    """Two independent methods agree, a real motor is slower than an ideal one, and (125) holds for both."""
    horizon = beyond(driven.joint, 1.3)
    optimum = program.largest_velocity(driven, horizon, steps=400, finest=1e-3)
    second = collocation.largest_velocity(driven, horizon, intervals=400)
    assert second.velocity == pytest.approx(optimum.velocity, rel=3e-4)
    assert 0.8 < optimum.velocity / driven.joint.fastest(horizon) < 1.0
    assert np.abs(optimum.motor_velocity).max() <= 1.0 + 1e-9
    fine = np.linspace(0.0, horizon, 200_001)
    motor = np.interp(fine, optimum.time, optimum.motor_velocity)
    by_125 = np.trapezoid(driven.joint.response(horizon - fine) * motor, fine)
    assert by_125 == pytest.approx(optimum.velocity, rel=1e-4)


def test_fast_motors_approach_the_velocity_drive():
    joint = ViscoElasticJoint(OMEGA, 0.3)
    horizon = beyond(joint, 1.3)
    found = [
        program.largest_velocity(DrivenJoint(joint, "acceleration", a, 1.0), horizon, 40).velocity
        for a in (10.0, 1000.0)
    ]
    assert found == sorted(found)
    assert found[-1] == pytest.approx(joint.fastest(horizon), rel=1e-4)
