"""A joint at rest under the switching controller, and the devices that `max_velocity` refuses."""

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joint_methods import BangBangJointParameters
from via_controllers.joints.max_velocity import joint_of
from via_core.devices import load_device
from via_core.errors import ParameterError

DEVICE = load_device("visco_elastic_demo")
STEP, FINE = 1e-3, 10  # [s]; integration steps per sample


def swung(seconds, held=(np.inf, np.inf), start=1.0):
    """Link angles [rad] and switches at each sample of the joint from rest; the link is clamped between two times."""
    controller = BangBangJointParameters(start=start).build().supervisor.controller.controller
    link, motor, spring = DEVICE.link, DEVICE.motors[0], DEVICE.springs[0]
    q = speed = theta = rate = 0.0
    state, angles, switches = controller.init(), [], []
    for tick in range(round(seconds / STEP)):
        state, torques = controller.step(state, JointSample(tick * STEP, q, np.array([theta])))
        angles.append(q)
        switches.append(state.switch)
        for _ in range(FINE):
            load = float(spring.torque_at(q - theta))
            rate += STEP / FINE * (torques.torque[0] + load - motor.viscous_friction * rate) / motor.inertia
            speed -= STEP / FINE * (load + link.viscous_friction * speed) / link.inertia
            if held[0] <= tick * STEP < held[1]:
                speed = 0.0
            theta, q = theta + STEP / FINE * rate, q + STEP / FINE * speed
    return np.array(angles), np.array(switches)


def test_a_joint_at_rest_is_pushed_after_the_time_it_rests_and_then_swings():
    angles, switches = swung(8.0)
    assert np.flatnonzero(switches)[0] == pytest.approx(1.0 / STEP, abs=1)
    assert np.ptp(angles[:1000]) == 0.0 and np.ptp(angles[-2000:]) > 0.1
    assert set(switches[-2000:]) >= {-1, 1}


def test_it_swings_again_after_it_was_held():
    angles, _ = swung(14.0, held=(5.0, 6.0))
    assert np.ptp(angles[5100:5900]) == 0.0 and np.ptp(angles[-2000:]) > 0.1


def test_without_start_it_waits_for_a_push():
    angles, switches = swung(4.0, start=0.0)
    assert not angles.any() and not switches.any()


def test_max_velocity_refuses_joints_whose_times_of_reversal_it_does_not_know():
    assert joint_of(DEVICE).frequency > 0.0
    data = DEVICE.model_dump(mode="python")
    cubic = {"law": "odd_polynomial", "odd_coefficients": (5.0, 10.0), "max_deflection": 1.0}
    for changed, words in (
        ({"springs": [cubic]}, "12.5 at half of max_deflection"),
        ({"link": data["link"] | {"gravity_torque": 2.0}}, "gravity torque of 2 N m"),
    ):
        with pytest.raises(ParameterError, match=words):
            joint_of(type(DEVICE).model_validate(data | changed))
