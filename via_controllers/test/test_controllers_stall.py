"""Motors that do not follow their torque: when the torque ends, and when it returns."""

import numpy as np
import pytest
from via_controllers.contract import ArmSample
from via_controllers.joint_axes import JointAxes
from via_controllers.supervision.stall import LONGEST_REST, REST, StallDetection
from via_core.devices import load_device

DETECTION = StallDetection(JointAxes(load_device("qbmove_a")))
STEP, TORQUE = 1e-3, np.array([3.0, -3.0])  # [s], [N m]


def at(time, theta=0.0):
    zeros = np.zeros(2)
    return ArmSample(time, zeros, zeros, np.full(2, theta), zeros, np.full(2, np.nan))


def driven(seconds):
    """State and times [s] at which the torque acted on motors whose encoders repeat one number."""
    state, times = DETECTION.init(at(0.0)), []
    for time in np.arange(1, round(seconds / STEP)) * STEP:
        acts = not DETECTION.holds(state)
        if acts:
            times.append(time)
        state = DETECTION.step(state, at(time), TORQUE if acts else np.zeros(2), 0.1)
    return state, np.array(times)


def test_a_frozen_encoder_lets_torque_through_ever_more_rarely():
    _, times = driven(40.0)
    rests = np.diff(times)[np.diff(times) > 2.0 * STEP]
    assert rests == pytest.approx(REST * 2.0 ** np.arange(len(rests)), abs=3.0 * STEP) and len(rests) == 5
    assert times[0] < 2.0 * STEP and len(times) * STEP < 0.6  # of 40 s


def test_the_rest_ends_and_its_length_returns_once_the_motors_move():
    state, _ = driven(5.0)
    assert state.rest > REST and state.rest <= LONGEST_REST
    assert DETECTION.holds(state)
    time = state.time
    while DETECTION.holds(state):
        time += STEP
        state = DETECTION.step(state, at(time, 1e-4 * time), np.zeros(2), 0.1)
    assert state.rest == REST and time < 5.0 + 4.0
    for _ in range(1000):  # motors that move are never stalled
        time += STEP
        state = DETECTION.step(state, at(time, 1e-4 * time), TORQUE, 0.1)
        assert not DETECTION.holds(state)
