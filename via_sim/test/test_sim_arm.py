"""A flexible arm in motion: energy is kept, limits and stops hold, a loaded start is a loaded start."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from scipy.integrate import quad
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_sim.arm import ArmState, arm_step, loaded_state

ARM = load_vsa_arm("reference_4dof")
REST, STILL = np.array([0.2, 0.4, 0.3, 1.2]), np.zeros(4)


def start(offset: float = 0.1) -> ArmState:
    return ArmState(REST + offset, STILL, ARM.rest(REST), STILL)


def energy(state: ArmState) -> float:
    links = 0.5 * state.velocity @ ARM.inertia(state.q) @ state.velocity
    height = pinocchio.computePotentialEnergy(ARM.model, ARM.model.createData(), state.q)
    motors = 0.5 * state.motor_velocity @ (ARM.motor_inertia * state.motor_velocity)
    springs = sum(
        quad(lambda d, law=law: float(law.torque(d)), 0.0, phi, epsabs=1e-12)[0]
        for law, phi in zip(ARM.springs, state.q - state.theta, strict=True)
    )
    return float(links + height + motors + springs)


def test_without_torques_energy_is_kept():
    state, before = start(), energy(start())
    for _ in range(100):
        state = arm_step(ARM, state, STILL, STILL, 2e-3)
    assert np.abs(state.velocity).max() > 0.1
    assert energy(state) == pytest.approx(before, abs=1e-8)


def test_steps_converge_with_the_fourth_order():
    def after(substeps: int) -> np.ndarray:
        state = start()
        for _ in range(5):
            state = arm_step(ARM, state, np.ones(4), STILL, 0.04, substeps)
        return np.concatenate([state.q, state.velocity])

    exact = after(64)
    coarse, fine = (np.abs(after(n) - exact).max() for n in (4, 8))
    assert coarse / fine == pytest.approx(16.0, rel=0.3)


def test_held_at_rest_it_rests():
    state, load = start(0.0), ARM.gravity(REST)
    for _ in range(200):
        state = arm_step(ARM, state, load, STILL, 1e-3)
    assert state.q == pytest.approx(REST, abs=1e-10)


def test_a_load_on_the_links_pushes_them():
    state = arm_step(ARM, start(0.0), ARM.gravity(REST), np.array([1.0, 0.0, 0.0, 0.0]), 1e-3)
    assert state.velocity == pytest.approx(1e-3 * np.linalg.inv(ARM.inertia(REST))[:, 0], rel=1e-3)


def test_motors_have_limits():
    state = start(0.0)
    assert np.array_equal(
        arm_step(ARM, state, np.full(4, 1e4), STILL, 1e-3).theta,
        arm_step(ARM, state, ARM.torque_limit, STILL, 1e-3).theta,
    )


def test_a_motor_does_not_drive_itself_beyond_its_speed():
    """Joint 0 carries no gravity; a load may still drive a motor on."""
    state, arm = start(0.0), replace(ARM, speed_limit=np.full(4, 0.2))
    torque = ARM.gravity(REST) + np.array([30.0, 0.0, 0.0, 0.0])
    for _ in range(30):
        state = arm_step(arm, state, torque, STILL, 1e-3)
    assert 0.15 < state.motor_velocity[0] < 0.22


def test_a_spring_at_its_stop_is_told():
    with pytest.raises(ParameterError, match="stops"):
        arm_step(ARM, start(0.7), STILL, STILL, 1e-3)


def test_a_loaded_start_has_the_torque_and_the_rate_asked_for():
    torque, rate = np.array([3.0, -12.0, 1.0, -0.5]), np.array([10.0, -20.0, 5.0, 1.0])
    state = loaded_state(ARM, REST, np.full(4, 0.3), torque, rate)
    found, stiffness, _ = ARM.spring_state(state.q - state.theta)
    assert found == pytest.approx(torque, abs=1e-10)
    assert stiffness * (state.velocity - state.motor_velocity) == pytest.approx(rate)
