"""Limit cycle on one mode of a rigid arm: torque term by term, equations, and time to converge."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from via_controllers.arms.modal_limit_cycle import (
    CRITICAL,
    STRENGTH,
    ModalLimitCycle,
    _returned,
    orbit_input,
)
from via_controllers.arms.modal_transform import first_basis, next_basis
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm

ARM = load_vsa_arm("reference_4dof")
REST = np.array([0.2, 0.4, 0.3, 1.2])
K = np.diag([100.0, 100.0, 60.0, 60.0])
XI, GAIN, LEVEL = 0.7, 3.0, 0.02


def cycle(mode: int) -> ModalLimitCycle:
    return ModalLimitCycle(ARM, REST, K, mode, XI, GAIN, LEVEL)


def states(count: int):
    random = np.random.default_rng(5)
    for _ in range(count):
        yield REST + random.uniform(-0.3, 0.3, 4), random.uniform(-2.0, 2.0, 4)


@pytest.mark.parametrize("mode", [0, 1, 3])
def test_torque_is_that_of_82_90_and_91(mode):
    """Every matrix of the document assembled, Wdd differenced along the motion that the torque causes."""
    controller = cycle(mode)
    for q, v in states(5):
        motion = controller.at(controller.init(q), q, v)
        W, values, M = motion.basis.W, motion.basis.eigenvalues, ARM.inertia(q)
        along, near = motion.acceleration, motion.basis

        def W_at(s, q=q, v=v, along=along, near=near):
            return next_basis(near, ARM.inertia(q + s * v + 0.5 * s * s * along), K).W

        Wd = (W_at(1e-5) - W_at(-1e-5)) / 2e-5
        Wdd = (W_at(2e-4) - 2.0 * W + W_at(-2e-4)) / 4e-8
        xi = np.full(4, XI)
        xi[mode] = 0.0
        inverse = np.linalg.inv(W)
        D = inverse.T @ np.diag(2.0 * xi * np.sqrt(values)) @ inverse
        z, zd = inverse @ (q - REST), inverse @ (v - Wd @ inverse @ (q - REST))
        u = np.zeros(4)
        k = mode
        H = 0.5 * zd[k] ** 2 / values[k] + 0.5 * z[k] ** 2
        rate = motion.eigenvalue_rates[k]
        u[k] = values[k] * (-GAIN * (H - LEVEL) * zd[k] + rate / (2.0 * values[k] ** 2) * zd[k])
        gamma = (M @ Wdd + D @ Wd) @ z + 2.0 * M @ Wd @ zd
        torque = inverse.T @ u + gamma + ARM.coriolis(q, v) @ v + ARM.gravity(q) - D @ v - K @ (q - REST)
        assert_allclose(motion.torque, torque, atol=2e-4 * np.abs(torque).max())
        assert_allclose([motion.H, motion.V], [H, 0.5 * (H - LEVEL) ** 2], rtol=1e-6)


@pytest.mark.parametrize(("direction", "level"), [(0.0, LEVEL), (0.7, 0.3), (-1.0, 0.3)])
def test_h_changes_by_103_and_by_the_power_of_the_start(direction, level):
    controller = replace(cycle(0), level=level)
    for q, v in states(5):
        motion = controller.at(controller.init(q), q, v, direction)
        h = 1e-5
        ahead, behind = (
            controller.at(motion.basis, q + s * v + 0.5 * s * s * motion.acceleration, v + s * motion.acceleration).H
            for s in (h, -h)
        )
        speed = motion.z_velocity[0]
        assert (motion.push != 0.0) == (direction != 0.0 and 0.8 * level > motion.H)
        expected = -GAIN * (motion.H - level) * speed**2 + motion.push * speed
        assert (ahead - behind) / (2.0 * h) == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_second_derivative_of_v_is_the_corrected_one():
    """Printed as -2 k_V (H - H_d)^2 (k_V zd + zd zdd); right is Vdd = -2 k_V (H - H_d)^2 (zd zdd - k_V zd^4)."""

    def eigenvalue(t):
        return 100.0 * (1.0 + 0.2 * np.sin(3.0 * t)), 60.0 * np.cos(3.0 * t)

    def off_level(t, x):
        value, _ = eigenvalue(t)
        return 0.5 * (x[1] ** 2 / value + x[0] ** 2) - LEVEL

    def slope(t, x):
        value, rate = eigenvalue(t)
        return np.array([x[1], -value * x[0] + orbit_input(value, rate, GAIN * off_level(t, x), x[1])])

    def V_at(t, x, h):
        k1 = slope(t, x)
        k2 = slope(t + 0.5 * h, x + 0.5 * h * k1)
        k3 = slope(t + 0.5 * h, x + 0.5 * h * k2)
        k4 = slope(t + h, x + h * k3)
        return 0.5 * off_level(t + h, x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)) ** 2

    t, x, h = 0.4, np.array([0.12, 0.9]), 1e-4
    found = (V_at(t, x, h) - 2.0 * V_at(t, x, 0.0) + V_at(t, x, -h)) / h**2
    speed, change = slope(t, x)
    common = -2.0 * GAIN * off_level(t, x) ** 2
    assert found == pytest.approx(common * (speed * change - GAIN * speed**4), rel=1e-4)
    assert found != pytest.approx(common * (GAIN * speed + speed * change), rel=0.1)


def test_at_the_equilibrium_only_the_printed_controller_stays_at_rest():
    controller = replace(cycle(0), start=0.0)
    for direction in (0.0, 1.0):
        motion = controller.at(controller.init(REST), REST, np.zeros(4), direction)
        assert motion.torque == pytest.approx(ARM.gravity(REST), abs=1e-12)
        assert motion.H == motion.push == 0.0 and motion.V == 0.5 * LEVEL**2
    motion = cycle(0).at(controller.init(REST), REST, np.zeros(4), -1.0)
    basis = motion.basis
    push = -0.5 * np.sqrt(2.0 * LEVEL) * basis.eigenvalues[0]
    assert motion.torque == pytest.approx(ARM.gravity(REST) + ARM.inertia(REST) @ basis.W[:, 0] * push)


def test_modes_are_numbered_at_the_equilibrium_and_tracked_from_there():
    controller = cycle(2)
    far = REST + np.array([0.3, -0.5, -1.2, -1.0])
    slow = first_basis(ARM.inertia(REST), K)
    for share in np.linspace(0.0, 1.0, 400):
        slow = next_basis(slow, ARM.inertia(REST + share * (far - REST)), K)
    assert_allclose(controller.init(far).W, slow.W, atol=1e-12)
    assert_allclose(controller.init(REST).W, first_basis(ARM.inertia(REST), K).W, atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        {"mode": 4},
        {"mode": -1},
        {"damping_ratio": 0.0},
        {"gain": -1.0},
        {"level": float("nan")},
        {"start": -0.1},
        {"start": 1.1},
        {"start": float("nan")},
        {"equilibrium": [0.0, 0.0]},
        {"stiffness": np.diag([1.0, 1.0, 1.0, -1.0])},
        {"stiffness": K + np.triu(np.ones((4, 4)), 1)},
    ],
)
def test_invalid_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(cycle(0), **change)


def test_a_soft_stiffness_is_accepted():
    assert np.array_equal(replace(cycle(0), stiffness=0.01 * K).stiffness, 0.01 * K)


@pytest.mark.parametrize(("factor", "critical"), [(1.02, True), (0.98, False)])
def test_far_above_its_level_the_mode_is_damped_critically(factor, critical):
    """Hd by differences along the desired motion, on both sides of k_V (H - H_d) sqrt(lambda) = 2, at z = 0."""
    controller, step = cycle(0), 1e-5
    near = controller.init(REST)
    value = near.eigenvalues[0]
    level = LEVEL + factor * CRITICAL / (GAIN * np.sqrt(value))
    velocity = near.W[:, 0] * np.sqrt(2.0 * value * level)
    now = controller.at(near, REST, velocity)
    there = [
        controller.at(near, REST + s * velocity + 0.5 * s * s * now.acceleration, velocity + s * now.acceleration).H
        for s in (-step, step)
    ]
    square, rate = now.z_velocity[0] ** 2, now.eigenvalue_rates[0]
    wanted = -GAIN * (level - LEVEL) * square
    if critical:
        wanted = -CRITICAL * square / np.sqrt(value) - square * rate / (2.0 * value**2)
    assert pytest.approx(level, rel=1e-9) == now.H
    assert (there[1] - there[0]) / (2.0 * step) == pytest.approx(wanted, rel=1e-4)


def test_links_return_within_the_strength_of_their_springs():
    controller = cycle(0)
    strength = controller._strength
    held = [float(np.abs(spring.torque_at(STRENGTH * spring.max_deflection))) for spring in ARM.springs]
    assert strength == pytest.approx(held)
    for distance, wanted in ((0.9, 1.0), (1.0, 1.0), (2.0, 0.5), (10.0, 0.1)):
        q = REST + distance * np.array([0.0, 0.0, -strength[2] / K[2, 2], 0.5 * strength[3] / K[3, 3]])
        assert _returned(K, REST, q, strength) == pytest.approx(wanted)
