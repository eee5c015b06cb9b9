"""Motion of a flexible arm: energy, limits, stops, loaded initial state, contacts."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from scipy.integrate import quad
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_sim.robots.arm import ArmState, arm_step, contact_force
from via_sim.robots.contacts import Contact, Hand, Wall

ARM = load_vsa_arm("reference_4dof")
REST, STILL = np.array([0.2, 0.4, 0.3, 1.2]), np.zeros(4)


def start(offset: float = 0.1) -> ArmState:
    return ArmState(REST + offset, STILL, ARM.rest(REST), STILL)


def energy(state: ArmState) -> float:
    links = 0.5 * state.velocity @ ARM.inertia(state.q) @ state.velocity
    height = pinocchio.computePotentialEnergy(ARM.model, ARM.model.createData(), state.q)
    motors = 0.5 * state.motor_velocity @ (ARM.motor_inertia * state.motor_velocity)
    springs = sum(
        quad(lambda d, spring=spring: float(spring.torque(d)), 0.0, phi, epsabs=1e-12)[0]
        for spring, phi in zip(ARM.springs, state.q - state.theta, strict=True)
    )
    return float(links + height + motors + springs)


def test_energy_is_conserved_without_torques():
    state, before = start(), energy(start())
    for _ in range(100):
        state = arm_step(ARM, state, STILL, 2e-3)
    assert np.abs(state.velocity).max() > 0.1
    assert energy(state) == pytest.approx(before, abs=1e-8)


def test_steps_converge_with_fourth_order():
    def after(substeps: int) -> np.ndarray:
        state = start()
        for _ in range(5):
            state = arm_step(ARM, state, np.ones(4), 0.04, substeps)
        return np.concatenate([state.q, state.velocity])

    exact = after(64)
    coarse, fine = (np.abs(after(n) - exact).max() for n in (4, 8))
    assert coarse / fine == pytest.approx(16.0, rel=0.3)


def test_arm_stays_at_rest_under_gravity_compensation():
    state, load = start(0.0), ARM.gravity(REST)
    for _ in range(200):
        state = arm_step(ARM, state, load, 1e-3)
    assert state.q == pytest.approx(REST, abs=1e-10)


class Push(Contact):
    """A constant force on the tip."""

    def touches(self, position: np.ndarray) -> bool:
        return True

    def force(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return np.array([0.0, 1.0, 0.0])


def test_a_force_on_the_tip_accelerates_the_links():
    state = arm_step(ARM, start(0.0), ARM.gravity(REST), 1e-3, contacts=[Push()])
    load = ARM.tip_jacobian(REST).T @ Push().force(STILL, STILL)
    assert state.velocity == pytest.approx(1e-3 * np.linalg.inv(ARM.inertia(REST)) @ load, rel=1e-3)


def test_motor_torque_is_limited():
    state = start(0.0)
    assert np.array_equal(
        arm_step(ARM, state, np.full(4, 1e4), 1e-3).theta,
        arm_step(ARM, state, ARM.torque_limit, 1e-3).theta,
    )


def test_motor_torque_vanishes_beyond_the_speed_limit():
    """Joint 0 has no gravity load; a load may still accelerate a motor."""
    state, arm = start(0.0), replace(ARM, speed_limit=np.full(4, 0.2))
    torque = ARM.gravity(REST) + np.array([30.0, 0.0, 0.0, 0.0])
    for _ in range(30):
        state = arm_step(arm, state, torque, 1e-3)
    assert 0.15 < state.motor_velocity[0] < 0.22


def test_spring_beyond_its_stop_raises():
    with pytest.raises(ParameterError, match="stops"):
        arm_step(ARM, start(0.7), STILL, 1e-3)


def test_wall_pushes_and_never_pulls():
    wall = Wall(np.array([0.0, 0.1, 0.0]), np.array([0.0, 1.0, 0.0]), stiffness=1000.0, damping=10.0)
    still, inside = np.zeros(3), np.array([5.0, 0.08, -3.0])
    assert wall.force(inside, still) == pytest.approx([0.0, 20.0, 0.0])
    assert wall.force(inside, np.array([1.0, -1.0, 1.0])) == pytest.approx([0.0, 30.0, 0.0])
    assert np.array_equal(wall.force(inside, np.array([0.0, 3.0, 0.0])), still)
    assert np.array_equal(wall.force(np.array([0.0, 0.1 + 1e-9, 0.0]), np.array([0.0, -9.0, 0.0])), still)


def test_wall_supports_the_arm():
    """The arm sinks until the wall balances the missing motor torque: J' F is their difference."""
    state, load = start(0.0), ARM.gravity(REST) + np.array([0.0, 6.0, 0.0, 0.0])
    floor = Wall(ARM.tip_position(REST) - np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 1.0]))
    arm = replace(ARM, link_friction=np.full(4, 3.0), motor_friction=np.full(4, 6.0))
    for _ in range(1500):
        state = arm_step(arm, state, load - 50.0 * (state.theta - ARM.rest(REST)), 1e-3, contacts=(floor,))
    force = contact_force(arm, state.q, state.velocity, (floor,))
    assert force[2] > 3.0 and force[:2] == pytest.approx([0.0, 0.0])
    depth = floor.point[2] - arm.tip_position(state.q)[2]
    assert force[2] == pytest.approx(5e4 * depth, rel=1e-3)
    tau_e, _, _ = arm.spring_state(state.q - state.theta)
    assert tau_e + arm.gravity(state.q) == pytest.approx(arm.tip_jacobian(state.q).T @ force, abs=1e-2)


def test_stiff_contact_is_integrated():
    """One impact with the default of four steps per millisecond and with forty."""

    def after(substeps: int) -> tuple[np.ndarray, float]:
        state, most = replace(start(0.0), velocity=np.array([0.0, 1.0, 0.0, 0.5])), 0.0
        floor = Wall(ARM.tip_position(REST) - np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 1.0]))
        for _ in range(60):
            state = arm_step(ARM, state, ARM.gravity(REST), 1e-3, substeps, (floor,))
            most = max(most, contact_force(ARM, state.q, state.velocity, (floor,))[2])
        return state.velocity, most

    (velocity, force), (exact, _) = after(4), after(40)
    assert force > 50.0
    assert velocity == pytest.approx(exact, abs=0.005 * np.abs(exact).max())


def test_hand_holds_the_tip():
    state = start(0.0)
    hand = Hand(ARM.tip_position(REST) + np.array([0.0, 0.05, 0.0]))
    for _ in range(800):
        state = arm_step(ARM, state, ARM.gravity(REST) - 30.0 * state.motor_velocity, 1e-3, contacts=(hand,))
    assert ARM.tip_position(state.q) == pytest.approx(hand.point, abs=5e-3)


def test_wall_normal_is_normalised():
    wall = Wall(np.zeros(3), np.array([0.0, 3.0, 4.0]))
    assert wall.normal == pytest.approx([0.0, 0.6, 0.8])
    assert wall.depth(np.array([0.0, 0.0, -1.0])) == pytest.approx(0.8)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Wall(np.zeros(3), np.zeros(3)),
        lambda: Wall(np.zeros(2), np.array([0.0, 0.0, 1.0])),
        lambda: Wall(np.zeros(3), np.array([0.0, 0.0, 1.0]), stiffness=-1.0),
        lambda: Hand(np.full(3, np.nan)),
    ],
)
def test_invalid_contacts_are_refused(wrong):
    with pytest.raises(ParameterError):
        wrong()
