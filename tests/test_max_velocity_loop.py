"""Section 7's policy on the simulated joint: as fast as the closed form, less the loss of a real motor."""

from dataclasses import replace

import numpy as np
import pytest
from via_bringup.demo.reference import throwing_controller
from via_controllers.contract import JointSample
from via_controllers.joints.max_velocity import MaxVelocity, joint_of
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_sim.sensors import IDEAL, Sensors
from via_validation.control.throw import RATE, throw

DEVICE = load_device("visco_elastic_demo")


@pytest.mark.parametrize(("damper", "turns"), [(0.0, 0), (0.0, 3), (0.5, 2), (1.0, 1)])
def test_the_link_is_as_fast_as_the_closed_form(damper, turns):
    controller, ideal = throwing_controller(DEVICE, damper, turns)
    for sensors in (IDEAL, Sensors.of_device(DEVICE)):
        assert throw(DEVICE, controller, damper, sensors).velocity[-1] == pytest.approx(ideal, rel=5e-3)


@pytest.mark.parametrize(("damper", "turns"), [(0.0, 3), (1.0, 1)])
def test_the_motor_respects_its_speed_limit(damper, turns):
    controller, _ = throwing_controller(DEVICE, damper, turns)
    seen = throw(DEVICE, controller, damper, Sensors.of_device(DEVICE), more=0.3)
    assert np.abs(seen.motor_velocity).max() < 1.02 * controller.velocity


def test_uniform_reversals_are_slower_on_the_joint_too():
    """The printed 'period of omega_d' also for the last interval, on the simulated joint with D = .4."""
    controller, ideal = throwing_controller(DEVICE, 1.0, 2)
    between = joint_of(DEVICE, 1.0).between_turns
    uniform = replace(controller, turns=tuple(controller.horizon - between * np.arange(2, 0, -1)))
    assert throw(DEVICE, uniform, 1.0).velocity[-1] < 0.9 * ideal


def test_after_the_horizon_the_motor_holds_still():
    controller, _ = throwing_controller(DEVICE, 1.0, 2)
    after = throw(DEVICE, controller, 1.0, more=3.0)
    there, rate = controller.reference(controller.horizon + 3.0)
    assert after.theta[-1] == pytest.approx(there, abs=1e-3)
    assert rate == 0.0 and abs(after.velocity[-1]) < 0.01


def test_the_motor_never_gets_more_than_its_torque():
    controller, _ = throwing_controller(DEVICE, 0.0, 3)
    controller = replace(controller, torque_limit=3.0)
    state = controller.init()
    for tick in range(500):
        state, out = controller.step(state, JointSample(tick / RATE, 0.3 * np.sin(tick / 20.0), np.array([0.0])))
        assert abs(out.torque[0]) <= 3.0
    assert out.saturated


def test_invalid_samples_give_zero_torque():
    controller, _ = throwing_controller(DEVICE, 0.0, 1)
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.0, np.zeros(1)))
    after, out = controller.step(state, JointSample(1e-3, np.nan, np.zeros(1)))
    assert after is state and out.torque == [0.0]


@pytest.mark.parametrize("name", ["cubic_demo", "maccepavd", "compact_vpda"])
def test_other_devices_are_refused(name):
    with pytest.raises(ParameterError, match=name):
        MaxVelocity.from_device(load_device(name), 1.0)
