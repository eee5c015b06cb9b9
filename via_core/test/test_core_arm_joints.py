"""Joints of an arm as devices, and an arm with payload and scaled springs."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import DeviceError
from via_core.vsa_arms import load_vsa_arm
from via_core.wire import link_name, motor_name

ARM = load_vsa_arm("reference_4dof")
Q, V = np.array([0.2, 0.5, 0.3, 1.1]), np.array([0.5, -1.0, 0.7, 1.5])


@pytest.mark.parametrize("joint", range(4))
def test_a_joint_is_a_device_with_motor_spring_and_names_of_the_arm(joint):
    device = load_device(f"reference_4dof:{ARM.joints[joint]}")
    phi = np.zeros(4)
    phi[joint] = 0.2
    assert (device.link_joint, *device.motor_joints) == (link_name(device.name), motor_name(device.name, 1))
    assert device.stiffness(0.2, [0.0]) == pytest.approx(ARM.spring_state(phi)[1][joint])
    assert device.motors[0].inertia == ARM.motor_inertia[joint]


@pytest.mark.parametrize("name", ["reference_4dof:wrist", "no_arm:elbow"])
def test_unknown_joints_and_arms_are_refused(name):
    with pytest.raises(DeviceError, match="there are"):
        load_device(name)


def test_a_payload_is_a_point_mass_at_the_tip():
    arm, J, m = ARM.corrected(0.7, np.ones(4)), ARM.tip_jacobian(Q), 0.7
    assert arm.inertia(Q) == pytest.approx(ARM.inertia(Q) + m * J.T @ J)
    assert arm.gravity(Q) == pytest.approx(ARM.gravity(Q) + m * J.T @ [0.0, 0.0, 9.81], abs=1e-9)
    slope = (ARM.tip_jacobian(Q + 1e-6 * V) - ARM.tip_jacobian(Q - 1e-6 * V)) / 2e-6  # Jdot
    wanted = ARM.coriolis(Q, V) @ V + m * J.T @ slope @ V
    assert arm.coriolis(Q, V) @ V == pytest.approx(wanted, abs=1e-6)
    assert ARM.inertia(Q) == pytest.approx(load_vsa_arm("reference_4dof").inertia(Q), abs=0)


def test_scaled_springs_scale_torque_stiffness_and_the_inverse():
    scale, phi = np.array([0.9, 1.0, 1.1, 1.3]), np.array([0.1, -0.2, 0.3, 0.05])
    arm = ARM.corrected(0.0, scale)
    for scaled, filed in zip(arm.spring_state(phi), ARM.spring_state(phi), strict=True):
        assert scaled == pytest.approx(scale * filed)
    assert arm.deflection(arm.spring_state(phi)[0]) == pytest.approx(phi)
    x = np.array([Q, V, Q - phi, np.zeros(4)])
    torque = -ARM.motor_inertia * arm.rates(x, np.zeros(4), np.zeros(4))[3]
    assert torque == pytest.approx(-arm.spring_state(phi)[0])
    assert arm.corrected(0.0, 1.0 / scale).spring_scale == pytest.approx(1.0)
