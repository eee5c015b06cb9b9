"""Samples that cannot be the motion of an arm."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from via_controllers.contract import ArmController, ArmSample, Torques
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.arm_supervision import GAP, Activity, Supervisor
from via_controllers.supervision.measured_motion import (
    CORRECTED,
    DEFLECTED,
    IMPOSSIBLE,
    VELOCITIES,
    MeasuredMotion,
    fault_of,
)

STEP, STOP = 1e-3, 0.6  # [s], [rad]


class Arm:
    """Two joints whose springs have no torque."""

    n = 2
    motor_inertia, motor_friction, torque_limit = np.full(2, 0.02), np.full(2, 0.1), np.full(2, 5.0)
    speed_limit, deflection_limit = np.full(2, 10.0), np.full(2, STOP)

    def loads(self, q, velocity, theta, motor_velocity):
        return np.zeros(2), np.zeros(2)


@dataclass(frozen=True)
class Fails(ArmController[int]):
    """Raises `error` on the third sample."""

    error: Exception
    quantities = ()

    def init(self, sample):
        return 0

    def observe(self, state):
        return np.empty(0)

    def step(self, state, sample):
        if state == 2:
            raise self.error
        return state + 1, Torques(np.zeros(2), False)


def moving(time, speed=2.0, published=1.0):
    """A sample of both joints swinging together, with `published` times their velocity."""
    q = np.full(2, speed * np.sin(6.0 * time) / 6.0)
    velocity = np.full(2, published * speed * np.cos(6.0 * time))
    return ArmSample(time, q, velocity, q.copy(), velocity.copy(), np.full(2, np.nan))


def first_fault(published=1.0, delay=0.0, bias=0.0, seconds=20.0, every=1):
    """Time [s] of the first fault of velocities, or None."""
    motion = MeasuredMotion.of(moving(0.0))
    for tick in range(every, round(seconds / STEP), every):
        now, late = moving(tick * STEP), moving(tick * STEP - delay, published=published)
        sample = replace(now, q_velocity=late.q_velocity + bias, theta_velocity=late.theta_velocity + bias)
        motion, fault = motion.next(sample, GAP)
        if fault:
            assert fault == VELOCITIES
            return tick * STEP
    return None


@pytest.mark.parametrize("published", [0.0, -1.0, 180.0 / np.pi], ids=["zero", "reversed", "degrees"])
def test_velocities_that_do_not_fit_are_found_within_a_period(published):
    found = first_fault(published)
    assert found is not None and found < 2.0 * np.pi / 6.0


@pytest.mark.parametrize("every", [1, 10])
def test_filtered_scaled_and_biased_velocities_are_no_fault(every):
    assert first_fault(1.1, delay=0.02, every=every) is None
    assert first_fault(bias=0.3, every=every) is None


def test_a_deflection_beyond_twice_the_stop_is_impossible():
    arm, sample = Arm(), moving(0.1)
    assert fault_of(sample, arm) == ""
    assert fault_of(replace(sample, theta=sample.q + 1.9 * STOP), arm) == ""
    assert fault_of(replace(sample, theta=sample.q + np.array([0.0, 2.1 * STOP])), arm) == DEFLECTED
    assert fault_of(replace(sample, theta=sample.theta + 2.0 * np.pi), arm) == DEFLECTED
    assert fault_of(replace(sample, q=np.array([0.0, np.nan])), arm) == IMPOSSIBLE


@pytest.mark.parametrize("error", [OverflowError("too large"), np.linalg.LinAlgError("singular")])
def test_a_controller_that_fails_on_a_sample_leaves_the_arm_passive_and_begins_anew(error):
    supervisor = Supervisor(Fails(error), Fails(error), ArmLimits(Arm()))
    state, found = supervisor.init(), []
    for tick in range(6):
        state, answer = supervisor.step(state, moving(tick * STEP), True)
        found.append((answer.activity, str(error) in answer.fault))
    active, passive = (Activity.ACTIVE, False), (Activity.PASSIVE, True)
    assert found == [active, active, passive, active, active, passive]


def test_velocities_that_do_not_fit_leave_the_arm_passive():
    supervisor = Supervisor(Fails(ValueError()), Fails(ValueError()), ArmLimits(Arm()))
    state, faults = supervisor.init(), []
    for tick in range(2000):
        sample = replace(moving(tick * STEP, published=0.0), time=tick * STEP)
        state, answer = supervisor.step(replace(state, inner=0), sample, True)
        faults.append(answer.fault)
    assert VELOCITIES in faults and faults[0] == ""


def test_limits_get_the_speed_of_the_angles_while_velocities_repeat():
    """A frozen velocity is an error of .2 rad only after the speed has changed by several rad/s."""
    n, step, pull = 2, 1e-3, 300.0  # [rad/s^2]
    found, motion = [], None
    for k in range(30):
        time = k * step
        angle, zero = np.full(n, 0.5 * pull * time**2), np.zeros(n)
        sample = ArmSample(time, np.zeros(n), zero, angle, zero, np.full(n, np.nan))
        motion = MeasuredMotion.of(sample) if motion is None else motion.next(sample, GAP)[0]
        found.append(motion.corrected.theta_velocity[0])
    lag = CORRECTED + step
    np.testing.assert_allclose(found[-1], pull * (29 * step - lag), atol=0.05 * found[-1])
    assert not motion.corrected.q_velocity.any()


@dataclass(frozen=True)
class Pushes(ArmController[None]):
    """As much torque as the motors have."""

    quantities = ()

    def init(self, sample):
        return None

    def observe(self, state):
        return np.empty(0)

    def step(self, state, sample):
        return None, Torques(Arm.torque_limit, False)


def test_motors_keep_their_speed_limit_while_velocities_repeat():
    """Until the fault is found; with the measured velocities alone they would reach 10 rad/s by then."""
    supervisor = Supervisor(Pushes(), Pushes(), ArmLimits(Arm()))
    state, speed, theta, fastest = supervisor.init(), np.zeros(2), np.zeros(2), 0.0
    for k in range(100):
        sample = ArmSample(k * STEP, theta, np.zeros(2), theta, np.zeros(2), np.full(2, np.nan))
        state, answer = supervisor.step(state, sample, True)
        speed = speed + STEP * (answer.torque - Arm.motor_friction * speed) / Arm.motor_inertia
        theta, fastest = theta + STEP * speed, max(fastest, float(speed[0]))
    assert answer.fault == VELOCITIES
    assert 4.0 < fastest < 7.0


def test_right_velocities_are_not_corrected():
    step, motion = 1e-3, None
    for k in range(200):
        time = k * step
        angle, speed = np.array([np.sin(9.0 * time)]), np.array([9.0 * np.cos(9.0 * time)])
        sample = ArmSample(time, angle, speed, angle, speed, np.array([np.nan]))
        motion = MeasuredMotion.of(sample) if motion is None else motion.next(sample, GAP)[0]
        np.testing.assert_allclose(motion.corrected.theta_velocity, speed, atol=1e-3)
