"""The limit cycle's set-up and time to converge, against the simulation and the definition."""

import numpy as np
import pytest
from via_controllers.arms.modal_limit_cycle import orbit_input
from via_core.vsa_arms import load_vsa_arm
from via_validation.control.limit_cycle import approach, least_share, loaded_state

ARM = load_vsa_arm("reference_4dof")
REST = np.array([0.2, 0.4, 0.3, 1.2])  # [rad]


def test_the_cycle_is_approached_as_by_103_averaged():
    """A mode of constant lambda, integrated from any start: within a hundredth of the level at half cycles."""
    value, gain, level, h = 100.0, 1.5, 0.02, 1e-4
    x, found = np.array([0.1 * np.sqrt(2.0 * level), 0.0]), []

    def slope(x):
        off = 0.5 * (x[1] ** 2 / value + x[0] ** 2) - level
        return np.array([x[1], -value * x[0] + orbit_input(value, 0.0, gain * off, x[1])])

    for tick in range(25_000):
        if tick % round(np.pi / np.sqrt(value) / h) == 0:
            found.append((tick * h, 0.5 * (x[1] ** 2 / value + x[0] ** 2) / level))
        k1 = slope(x)
        k2 = slope(x + 0.5 * h * k1)
        x = x + h * k2
    for time, share in found:
        assert share == pytest.approx(approach(0.01, gain, level, value, time), abs=0.02)
    assert found[0][1] == pytest.approx(0.01) and found[-1][1] > 0.8
    assert approach(least_share(0.9, gain, level, value, 0.7), gain, level, value, 0.7) == pytest.approx(0.9)


def test_loaded_state_has_the_given_spring_torque_and_rate():
    torque, rate = np.array([3.0, -12.0, 1.0, -0.5]), np.array([10.0, -20.0, 5.0, 1.0])
    state = loaded_state(ARM, REST, np.full(4, 0.3), torque, rate)
    found, stiffness, _ = ARM.spring_state(state.q - state.theta)
    assert found == pytest.approx(torque, abs=1e-10)
    assert stiffness * (state.velocity - state.motor_velocity) == pytest.approx(rate)
