"""Commanded torques: they act until the timeout, within the limits, and a command that does not fit is refused."""

from __future__ import annotations

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joints.commanded_torque import CommandedTorque
from via_core.errors import ParameterError

CONTROLLER = CommandedTorque((2.0, 3.0), timeout=0.02)


def stepped(state, time, q=0.0):
    return CONTROLLER.step(state, JointSample(time, q, np.zeros(2)))


def test_without_a_command_there_is_no_torque():
    state, answer = stepped(CONTROLLER.init(), 5.0)
    assert not answer.torque.any() and not answer.saturated
    assert np.isnan(CONTROLLER.observe(state)).all()


def test_a_command_acts_until_the_timeout_whatever_the_period_of_the_samples():
    for period in (0.001, 0.004, 0.01):
        state, _ = stepped(CONTROLLER.init(), 5.0)
        state = CONTROLLER.with_torque(state, np.array([1.0, -1.0]))
        acted = []
        for k in range(1, 60):
            state, answer = stepped(state, 5.0 + k * period)
            acted.append(k * period if answer.torque.any() else 0.0)
            if k == 1:
                assert answer.torque.tolist() == [1.0, -1.0]
        assert max(acted) == pytest.approx(0.02, abs=1e-9)


def test_a_command_is_limited_and_reported_as_commanded():
    state, _ = stepped(CONTROLLER.init(), 0.0)
    state = CONTROLLER.with_torque(state, np.array([5.0, -1.0]))
    state, answer = stepped(state, 0.001)
    assert answer.torque.tolist() == [2.0, -1.0] and answer.saturated
    assert CONTROLLER.observe(state) == pytest.approx([5.0, -1.0, 0.001])


@pytest.mark.parametrize("torque", [[1.0], [1.0, np.nan], [1.0, np.inf], [1.0, 2.0, 3.0]])
def test_a_command_that_does_not_fit_is_refused(torque):
    state, _ = stepped(CONTROLLER.init(), 0.0)
    with pytest.raises(ParameterError, match="2 finite torques"):
        CONTROLLER.with_torque(state, np.array(torque))


def test_a_stamp_before_the_command_has_no_torque():
    state, _ = stepped(CONTROLLER.init(), 1.0)
    state = CONTROLLER.with_torque(state, np.array([1.0, 1.0]))
    assert not stepped(state, 0.5)[1].torque.any()


@pytest.mark.parametrize("given", [{"timeout": 0.0}, {"torque_limit": (1.0, 0.0)}])
def test_parameters_out_of_range_are_refused(given):
    with pytest.raises(ParameterError):
        CommandedTorque(**{"torque_limit": (1.0, 1.0), **given})
