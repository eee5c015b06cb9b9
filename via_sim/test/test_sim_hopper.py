"""The hopper in MuJoCo against closed forms: fall, standstill, motors and springs."""

import numpy as np
import pytest
from via_core.errors import ParameterError
from via_core.hopper import Hopper
from via_sim.robots.hopper import HopperPlant

HOPPER, STILL = Hopper(), np.zeros(4)
PLANT = HopperPlant(HOPPER)
CROUCHED = HOPPER.crouched(0.6)


def test_free_fall():
    state = PLANT.start(CROUCHED, CROUCHED, 1.0)
    high = state.trunk[1]
    for _ in range(100):
        state = PLANT.step(state, STILL, 1e-3)
    assert state.time == pytest.approx(0.1)
    assert state.trunk[1] == pytest.approx(high - 0.5 * 9.81 * 0.1**2, rel=1e-3)
    assert state.q == pytest.approx(CROUCHED, abs=1e-9) and not state.force.any()


def test_initial_height_of_the_soles():
    assert PLANT.start(CROUCHED, CROUCHED, 1e-4).force.tolist() == [0.0, 0.0]
    assert (PLANT.start(CROUCHED, CROUCHED, -1e-4).force > 0.0).all()


def test_standstill_with_position_controlled_motors_matches_statics():
    stands, state = HOPPER.standing(0.6), PLANT.start(HOPPER.standing(0.6), CROUCHED, 0.0)
    hold = -HOPPER.spring_state(stands - CROUCHED)[0]
    for _ in range(2500):
        state = PLANT.step(state, hold - 200.0 * (state.theta - CROUCHED) - 4.0 * state.motor_velocity, 1e-3)
    assert state.q == pytest.approx(stands, abs=3e-3)
    mass = HOPPER.trunk_mass + 2.0 * (HOPPER.thigh_mass + HOPPER.shank_mass)
    assert state.force == pytest.approx(np.full(2, 0.5 * mass * 9.81), rel=1e-3)
    assert state.trunk[[0, 2]] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_motor_is_an_inertia_on_a_spring():
    """Heavy links hardly move within ten milliseconds: B thdd = tau + K (q - theta)."""
    state, torque = PLANT.start(CROUCHED, CROUCHED, 1.0), np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(10):
        state = PLANT.step(state, torque, 1e-3)
    omega = np.sqrt(HOPPER.hip_stiffness / HOPPER.rotor_inertia)
    expected = (1.0 - np.cos(omega * 0.01)) / HOPPER.hip_stiffness
    assert state.theta[0] - CROUCHED[0] == pytest.approx(expected, rel=0.03)
    assert np.abs(state.theta - CROUCHED)[1:].max() < 0.02 * expected


def test_positive_hip_angle_moves_the_leg_forward():
    state = PLANT.start(STILL, STILL, 1.0)
    for _ in range(30):
        state = PLANT.step(state, np.array([5.0, 0.0, 5.0, 0.0]), 1e-3)
    assert (state.q[[0, 2]] > 0.0).all()
    assert state.trunk[0] < 0.0  # the trunk gives way backwards


def test_step_depends_only_on_the_state():
    first = PLANT.start(CROUCHED, CROUCHED, 0.001)
    for _ in range(50):
        first = PLANT.step(first, np.ones(4), 1e-3)
    after = PLANT.step(first, STILL, 1e-3)
    PLANT.step(PLANT.start(STILL, STILL, 0.3), np.ones(4), 0.1)
    again = PLANT.step(first, STILL, 1e-3)
    assert np.array_equal(after.whole, again.whole) and np.array_equal(after.q, again.q)


def test_motor_torque_is_limited():
    state = PLANT.start(CROUCHED, CROUCHED, 1.0)
    most = PLANT.step(state, HOPPER.torque_limit, 1e-3)
    assert np.array_equal(PLANT.step(state, np.full(4, 1e4), 1e-3).theta, most.theta)


def test_durations_are_whole_steps():
    with pytest.raises(ParameterError, match="multiple"):
        PLANT.step(PLANT.start(CROUCHED, CROUCHED, 1.0), STILL, 3e-4)
