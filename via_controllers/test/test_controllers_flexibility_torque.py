"""Tracking of spring torques: (108) to the last digits, limits, and the effect of a linear spring model."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from via_controllers.arms.flexibility_torque import FlexibilityTorque, TorqueReference
from via_controllers.contract import ArmSample
from via_core.errors import ParameterError
from via_core.springs import CubicSpring, LinearSpring
from via_core.vsa_arms import VsaArm, load_vsa_arm

ARM = load_vsa_arm("reference_4dof")
MIXED = replace(
    ARM,
    springs=(ARM.springs[0], LinearSpring(0.6, 80.0), replace(ARM.springs[2], a=4.0), ARM.springs[3]),
    motor_friction=np.array([0.5, 0.0, 0.2, 0.1]),
)
OMEGA = 100.0  # [rad/s]
NO_SENSOR = np.full(4, np.nan)


def case(seed: int) -> tuple[ArmSample, TorqueReference]:
    random = np.random.default_rng(seed)
    q, v, w, phi = random.uniform([[-1.0], [-2.0], [-2.0], [-0.3]], [[1.0], [2.0], [2.0], [0.3]], (4, 4))
    return ArmSample(0.0, q, v, q - phi, w, NO_SENSOR), TorqueReference(*random.uniform(-20.0, 20.0, (3, 4)))


def residual(arm: VsaArm, seed: int, drop_slope: bool = False) -> float:
    """Residual of (108) over its largest term, with torques of (107) and the equations of motion of the arm."""
    controller, (sample, wanted) = FlexibilityTorque(arm, OMEGA), case(seed)
    seen = controller.observed(sample)
    used = seen._replace(stiffness_slope=0.0 * seen.stiffness_slope) if drop_slope else seen
    torque = controller.unlimited(sample, used, wanted)
    args = sample.q, sample.q_velocity, sample.theta, sample.theta_velocity
    qdd, thdd = arm.accelerations(*args, torque, np.zeros(4))
    phi_rate = sample.q_velocity - sample.theta_velocity
    second = seen.stiffness * (qdd - thdd) + seen.stiffness_slope * phi_rate**2
    e, e_rate, e_second = wanted.torque - seen.torque, wanted.rate - seen.rate, wanted.second - second
    terms = np.array([e_second, 2.0 * OMEGA * e_rate, (OMEGA**2 + seen.stiffness / arm.motor_inertia) * e])
    return float(np.abs(terms.sum(axis=0)).max() / np.abs(terms).max())


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 9999))
def test_the_error_obeys_108(seed):
    assert residual(ARM, seed) < 1e-10
    assert residual(MIXED, seed) < 1e-10


def test_a_linear_spring_model_violates_108():
    assert max(residual(ARM, seed, drop_slope=True) for seed in range(1, 20)) > 1e-4


def test_a_torque_sensor_replaces_the_spring_model():
    sample, _ = case(1)
    controller = FlexibilityTorque(ARM, OMEGA)
    measured = np.array([1.0, np.nan, 3.0, np.nan])
    seen = controller.observed(replace(sample, spring_torque=measured))
    nominal = controller.observed(sample).torque
    assert seen.torque == pytest.approx([1.0, nominal[1], 3.0, nominal[3]])
    expected = ARM.link_acceleration(sample.q, sample.q_velocity, -seen.torque)
    assert seen.acceleration == pytest.approx(expected)


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 9999))
def test_limits_hold_everywhere(seed):
    sample, wanted = case(seed)
    arm = replace(ARM, torque_limit=np.full(4, 5.0), speed_limit=np.full(4, 1.0))
    controller = FlexibilityTorque(arm, OMEGA)
    out = controller.torques(sample, controller.observed(sample), wanted)
    assert np.all(np.abs(out.torque) <= 5.0)
    fast = np.abs(sample.theta_velocity) >= 1.0
    assert np.all((out.torque * sample.theta_velocity)[fast] <= 0.0)
    unlimited = controller.unlimited(sample, controller.observed(sample), wanted)
    assert out.saturated == bool(np.any(out.torque != unlimited))


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_bandwidths_are_refused(bandwidth):
    with pytest.raises(ParameterError):
        FlexibilityTorque(ARM, bandwidth)


def test_a_spring_without_stiffness_gives_no_infinite_torque():
    """The torque of a cubic spring at zero deflection cannot be controlled: the motor stays passive."""
    arm = replace(ARM, springs=(CubicSpring(0.6, 10.0), *ARM.springs[1:]))
    controller, (sample, wanted) = FlexibilityTorque(arm, OMEGA), case(2)
    sample = replace(sample, theta=np.array([sample.q[0], *sample.theta[1:]]))
    with np.errstate(divide="ignore", invalid="ignore"):
        out = controller.torques(sample, controller.observed(sample), wanted)
    assert np.isfinite(out.torque).all() and np.all(np.abs(out.torque) <= arm.torque_limit)
