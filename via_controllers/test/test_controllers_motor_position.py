"""Motor position control: tracks its references, respects its limits, is passive for invalid samples."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from via_controllers.contract import JointSample
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.joints.multisine import Multisine
from via_core.errors import ParameterError
from via_core.springs import CubicSpring

STEP = 1e-3  # [s]
MOTOR_FRICTION = 1.27  # [N m s/rad]


def still(mean: float) -> Multisine:
    return Multisine(mean, (), ())


@pytest.fixture
def controller() -> MotorPositionControl:
    spring = CubicSpring(3.0, 10.0)
    return MotorPositionControl(
        springs=(spring, spring),
        equilibrium=still(0.2),
        preset=still(1.0),
        proportional_gain=50.0,
        derivative_gain=0.1,
        velocity_bandwidth=300.0,
        torque_limit=(100.0, 100.0),
        fade_in=0.2,
    )


def converged(controller: MotorPositionControl, duration: float, drop_static: bool = False) -> np.ndarray:
    """Motor angles (2,) [rad] after `duration` [s]: link held at the equilibrium, motors D thd = tau + tau_e."""
    q, theta, state = 0.2, np.array([0.2, 0.2]), controller.init()
    for n in range(round(duration / STEP)):
        state, out = controller.step(state, JointSample(n * STEP, q, theta))
        torque = out.torque.copy()
        if drop_static:
            torque += [
                float(controller.springs[i].torque(0.2 - d))
                for i, d in enumerate(controller.references(n * STEP, np.array([0.2, 0.2])))
            ]
        pull = np.array([float(spring.torque(q - t)) for spring, t in zip(controller.springs, theta, strict=True)])
        theta = theta + STEP / MOTOR_FRICTION * (torque + pull)
    return theta


def test_motors_reach_their_references_under_spring_load(controller):
    assert converged(controller, 1.0) == pytest.approx([1.2, -0.8], abs=1e-6)


def test_the_printed_form_is_off_by_the_spring_torque(controller):
    """(120) as printed: the springs shift the motors by about tau_e / (K_P + sigma)."""
    offset = abs(converged(controller, 1.0, drop_static=True) - [1.2, -0.8])
    assert np.all(offset > 0.1)


def test_derivative_gain_opposes_motion(controller):
    state = controller.init()
    controller = replace(controller, fade_in=1e-6)
    reference = controller.references(1.0, np.zeros(2))
    for n in range(2):
        state, at_rest = controller.step(state, JointSample(n * STEP, 0.2, reference))
    for n in range(1, 200):  # both motors pass their references at +1 rad/s
        state, moving = controller.step(state, JointSample((1 + n) * STEP, 0.2, reference + n * STEP))
    expected = at_rest.torque - controller.derivative_gain * 1.0 - controller.proportional_gain * 199 * STEP
    assert moving.torque == pytest.approx(expected, rel=1e-9)


def test_velocity_passes_a_first_order_low_pass(controller):
    """Motors start at 1 rad/s: after n samples the estimated speed is 1 - exp(-w_f n h)."""
    controller = replace(controller, velocity_bandwidth=100.0)
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.2, np.zeros(2)))
    for n in range(1, 6):
        state, _ = controller.step(state, JointSample(n * STEP, 0.2, np.full(2, n * STEP)))
        assert state.velocity == pytest.approx(np.full(2, 1.0 - np.exp(-100.0 * n * STEP)), rel=1e-9)


def test_static_torque_of_each_motor_is_that_of_its_own_spring(controller):
    controller = replace(controller, springs=(CubicSpring(3.0, 10.0), CubicSpring(3.0, 40.0)), fade_in=1e-6)
    reference = controller.references(1.0, np.zeros(2))
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.2, reference))
    _, out = controller.step(state, JointSample(1.0, 0.2, reference))
    assert out.torque == pytest.approx([10.0, -40.0])  # deflections of -1 and 1 rad, held against


@given(q=st.floats(-10, 10), one=st.floats(-100, 100), two=st.floats(-100, 100))
def test_limits_hold_everywhere(q, one, two):
    spring = CubicSpring(3.0, 10.0)
    controller = MotorPositionControl((spring, spring), still(0.0), still(0.5), 500.0, 1.0, 300.0, (6.0, 2.0), 0.1)
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.0, np.zeros(2)))
    _, out = controller.step(state, JointSample(STEP, q, np.array([one, two])))
    assert np.all(np.abs(out.torque) <= [6.0, 2.0])


@pytest.mark.parametrize("theta", [[np.nan, 0.0], [0.0, np.inf]])
def test_an_invalid_sample_gives_zero_torque_and_keeps_the_state(controller, theta):
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.2, np.zeros(2)))
    after, out = controller.step(state, JointSample(STEP, 0.2, np.array(theta)))
    assert after is state
    assert np.array_equal(out.torque, [0.0, 0.0])


def test_a_step_does_not_modify_the_state(controller):
    before, _ = controller.step(controller.init(), JointSample(0.0, 0.2, np.array([0.1, 0.2])))
    kept = before.theta.copy()
    controller.step(before, JointSample(STEP, 0.2, np.array([0.3, 0.4])))
    assert np.array_equal(before.theta, kept)
    with pytest.raises(FrozenInstanceError):
        before.time = 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"proportional_gain": 0.0},
        {"derivative_gain": -1.0},
        {"velocity_bandwidth": 0.0},
        {"torque_limit": (1.0, 0.0)},
        {"proportional_gain": float("nan")},
        {"fade_in": 0.0},
    ],
)
def test_invalid_parameters_are_refused(controller, change):
    with pytest.raises(ParameterError):
        replace(controller, **change)


def test_references_start_at_the_motor_angles_and_fade_in(controller):
    origin = np.array([-0.4, 0.9])
    _, out = controller.step(controller.init(), JointSample(5.0, 0.2, origin))
    held = [-float(spring.torque(0.25 - angle)) for spring, angle in zip(controller.springs, origin, strict=True)]
    assert out.torque == pytest.approx(held)  # only the static torque of the springs
    slope = (controller.references(1e-6, origin) - controller.references(0.0, origin)) / 1e-6
    assert slope == pytest.approx([0.0, 0.0], abs=1e-3)
    assert controller.references(0.1, origin) == pytest.approx(0.5 * (origin + np.array([1.2, -0.8])))
    assert controller.references(0.2, origin) == pytest.approx([1.2, -0.8])
    slope = (controller.references(0.2, origin) - controller.references(0.2 - 1e-6, origin)) / 1e-6
    assert slope == pytest.approx([0.0, 0.0], abs=1e-3)


def test_multisine_is_the_sum_of_its_tones():
    wave = Multisine(0.3, (0.1, 0.2), (1.0, 2.5))
    time = 1.7
    tones = 0.1 * np.sin(2 * np.pi * time) + 0.2 * np.sin(2 * np.pi * 2.5 * time)
    assert wave.at(time) == pytest.approx(0.3 + tones)


@pytest.mark.parametrize(
    "arguments",
    [(0.0, (0.1,), ()), (0.0, (0.1,), (0.0,)), (float("inf"), (), ()), (0.0, (float("nan"),), (1.0,))],
)
def test_invalid_multisines_are_refused(arguments):
    with pytest.raises(ParameterError):
        Multisine(*arguments)
