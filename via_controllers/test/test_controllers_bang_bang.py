"""PD control of motors and the modal bang-bang controller: signs, statics, limits, invalid samples."""

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.motor_pd import MotorPd
from via_controllers.contract import ArmSample
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm

ARM = load_vsa_arm("reference_4dof")
MOTORS = np.array([0.2, 0.5, 0.3, 1.3])
REST, STILL, NO_SENSOR = ARM.hanging(MOTORS), np.zeros(4), np.full(4, np.nan)
HOLD = MotorPd(ARM, MOTORS, REST, 60.0)
CONTROLLER = ModalBangBang(HOLD, np.array([0.0, 2.0, 0.0, 1.0]), amplitude=0.03, threshold=0.5, adaptation=50.0)
DIRECTION = CONTROLLER.direction


def sample(q=REST, theta=MOTORS, theta_velocity=STILL, time=0.0, torque=NO_SENSOR) -> ArmSample:
    return ArmSample(time, np.asarray(q), STILL, np.asarray(theta), theta_velocity, torque)


def motors_after(static: np.ndarray, duration: float = 0.5, step: float = 1e-3) -> np.ndarray:
    """Motor angles (4,) [rad] with the links at rest: B thdd = tau + tau_e; `static` is added to the torque."""
    theta, velocity = MOTORS.copy(), STILL
    for _ in range(round(duration / step)):
        torque = HOLD.torques(sample(theta=theta, theta_velocity=velocity), MOTORS).torque + static
        tau_e, _, _ = ARM.spring_state(REST - theta)
        velocity = velocity + step * (torque + tau_e) / ARM.motor_inertia
        theta = theta + step * velocity
    return theta


def test_motors_stay_on_their_reference():
    assert motors_after(STILL) == pytest.approx(MOTORS, abs=1e-9)


def test_the_printed_form_is_off_by_the_static_torque():
    """(120) as printed: offset K_P^-1 tau_e, reduced by the deflection of the springs."""
    off = motors_after(-HOLD.static_torque) - MOTORS
    _, stiffness, _ = ARM.spring_state(REST - MOTORS)
    expected = -HOLD.static_torque / (ARM.motor_inertia * 60.0**2 + stiffness)
    assert np.abs(off).max() > 5e-3
    assert off == pytest.approx(expected, rel=0.1, abs=1e-6)


def test_static_torque_is_gravity():
    assert HOLD.static_torque == pytest.approx(ARM.gravity(REST), abs=1e-9)


def test_a_motor_follows_like_a_critically_damped_one():
    theta, velocity, step = MOTORS + 0.05, STILL, 1e-4
    for _ in range(500):  # the spring load is compensated: the motor alone
        torque = HOLD.torques(sample(theta=theta, theta_velocity=velocity), MOTORS).torque
        velocity = velocity + step * (torque - HOLD.static_torque) / ARM.motor_inertia
        theta = theta + step * velocity
    assert theta - MOTORS == pytest.approx(np.full(4, 0.05 * (1.0 + 3.0) * np.exp(-3.0)), rel=0.02)


def test_torques_are_limited():
    out = HOLD.torques(sample(), MOTORS + 1.0)
    assert out.saturated and out.torque.tolist() == ARM.torque_limit.tolist()


def test_a_stretched_arm_is_pulled_further():
    """Links below q_0: the springs pull them up, and the motors move ahead in the same direction."""
    for side in (1.0, -1.0):
        state = CONTROLLER.init(sample(REST - side * 0.1 * DIRECTION))
        assert state.switch == side and state.torque * side > 0.5
        assert CONTROLLER.references(state) == pytest.approx(MOTORS + side * 0.03 * DIRECTION)
        assert state.y == pytest.approx(-side * 0.1)


def test_at_rest_nothing_switches():
    """Gravity loads the springs by 14 N m: the force is relative to this load."""
    state, out = CONTROLLER.step(CONTROLLER.init(sample()), sample(time=1e-3))
    assert state.switch == 0 and state.torque == pytest.approx(0.0, abs=1e-9)
    assert out.torque == pytest.approx(ARM.gravity(REST), abs=1e-9) and not out.saturated


def test_a_torque_sensor_replaces_the_spring_model():
    state = CONTROLLER.init(sample(torque=-ARM.gravity(REST) - 2.0 * DIRECTION))
    assert state.torque == pytest.approx(2.0) and state.switch == 1


def test_the_direction_follows_the_motion():
    state, w = CONTROLLER.init(sample()), np.array([0.8, 0.0, 0.6, 0.0])
    controller = replace(CONTROLLER, direction=np.array([1.0, 0.0, 0.0, 0.0]))
    state = controller.init(sample())
    for tick in range(1, 4000):
        state, _ = controller.step(state, sample(REST + 0.3 * np.sin(0.013 * tick) * w, time=1e-3 * tick))
    assert state.direction == pytest.approx(w, abs=0.01)


@pytest.mark.parametrize("step", [5e-4, 2e-3])
def test_adaptation_does_not_depend_on_the_rate_of_samples(step):
    def after(step: float) -> np.ndarray:
        state = CONTROLLER.init(sample())
        for tick in range(1, round(0.4 / step) + 1):
            time = tick * step
            swing = 0.2 * np.sin(13.0 * time) * np.array([1, 0, 0, 1])
            state, _ = CONTROLLER.step(state, sample(REST + swing, time=time))
        return state.direction

    assert after(step) == pytest.approx(after(1e-3), abs=5e-3)


def test_invalid_samples_give_zero_torque():
    state = CONTROLLER.init(sample())
    after, out = CONTROLLER.step(state, sample(np.array([0.2, np.nan, 0.3, 1.2]), time=1e-3))
    assert after is state and np.array_equal(out.torque, STILL)


def test_observed_quantities_have_names():
    state = CONTROLLER.init(sample(REST + 0.1 * DIRECTION))
    observed = dict(zip([quantity.name for quantity in CONTROLLER.quantities], CONTROLLER.observe(state), strict=True))
    assert observed["y"] == pytest.approx(0.1) and observed["switch"] == -1.0
    assert observed["w_2"] == pytest.approx(2.0 / 5.0**0.5)


@pytest.mark.parametrize(
    "change",
    [
        {"direction": STILL},
        {"direction": np.ones(3)},
        {"amplitude": -0.1},
        {"threshold": np.nan},
        {"adaptation": np.inf},
    ],
)
def test_invalid_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(CONTROLLER, **change)


@pytest.mark.parametrize("change", [{"bandwidth": 0.0}, {"motors": np.ones(3)}, {"equilibrium": NO_SENSOR}])
def test_invalid_motor_control_is_refused(change):
    with pytest.raises(ParameterError):
        replace(HOLD, **change)


def test_read_only_samples_are_accepted():
    """Read-only arrays have another type in compiled functions."""
    locked = MOTORS.copy()
    locked.flags.writeable = False
    _, out = CONTROLLER.step(CONTROLLER.init(sample(theta=locked)), sample(theta=locked, time=1e-3))
    assert out.torque == pytest.approx(ARM.gravity(REST), abs=1e-9)
