"""Equilibrium and stiffness of a joint: inverted springs, motor control, correction of the spring laws."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from via_controllers.contract import JointSample
from via_controllers.correction import LARGEST_FACTOR
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_controllers.joints.motor_references import MotorReferences, UnreachableError, resting
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status

DEVICE = load_device("qbmove_a")
VARYING = ("qbmove_a", "vsa2", "cubic_aa_vsa", "dlr_bavs", "maccepavd", "maccepa_2link_elbow")


@pytest.mark.parametrize("name", VARYING)
@settings(deadline=None, max_examples=8)
@given(q=st.floats(-0.3, 0.3), share=st.floats(0.02, 0.98))
def test_the_link_rests_there_with_that_stiffness(name, q, share):
    device = load_device(name)
    references = MotorReferences.from_device(device)
    low, high = references.stiffness_range(q)
    wanted = low + share * (high - low)
    theta = references.at(q, wanted)
    load = device.link.gravity_torque * np.sin(q - device.link.gravity_angle)
    assert device.torque_each(q, theta).sum() + load == pytest.approx(0.0, abs=1e-6 * max(1.0, high))
    assert device.stiffness(q, theta) == pytest.approx(wanted, rel=1e-6, abs=1e-9)


def slow_rest(device, q, preset):
    """`resting` with scipy and the device's spring laws."""
    reach = min(spring.max_deflection for spring in device.springs) - preset * (device.arrangement == "antagonistic")
    load = device.link.gravity_torque * np.sin(q - device.link.gravity_angle)

    def off(x):
        return float(device.torque_each(q, device.motor_angles(x, preset)).sum()) + load

    return q if abs(off(q)) < 1e-12 else brentq(off, q - reach, q + reach, xtol=1e-13)


def slow_at(references, q, stiffness):
    """`MotorReferences.at` likewise, for a stiffness between those of the end presets."""
    device = references.device

    def motors(preset):
        return device.motor_angles(slow_rest(device, q, preset), preset)

    preset = brentq(
        lambda preset: float(device.stiffness(q, motors(preset))) - stiffness, *references.presets, xtol=1e-13
    )
    return motors(preset)


@pytest.mark.parametrize("name", VARYING)
@settings(deadline=None, max_examples=6)
@given(q=st.floats(-0.3, 0.3), share=st.floats(0.02, 0.98))
def test_the_compiled_search_agrees_with_the_slow_one(name, q, share):
    references = MotorReferences.from_device(load_device(name))
    low, high = (references.stiffness(q, preset) for preset in references.presets)
    wanted = low + share * (high - low)
    assert references.at(q, wanted) == pytest.approx(slow_at(references, q, wanted), abs=1e-9)
    preset = share * references.presets[1]
    assert resting(references.device, q, preset) == pytest.approx(slow_rest(references.device, q, preset), abs=1e-9)


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("name", VARYING)
def test_a_stiffness_at_an_end_of_the_presets_is_reached(name, end):
    references = MotorReferences.from_device(load_device(name))
    preset = references.presets[end]
    theta = references.at(0.1, references.stiffness(0.1, preset))
    expected = references.device.motor_angles(resting(references.device, 0.1, preset), preset)
    assert theta == pytest.approx(expected, abs=1e-9)


@settings(deadline=None, max_examples=10)
@given(q=st.floats(-0.3, 0.3), share=st.floats(0.02, 0.98))
def test_levers_with_no_or_two_balances_give_a_correct_result_or_none(q, share):
    device = load_device("edinburgh_vsa")
    references = MotorReferences.from_device(device)
    low, high = references.stiffness_range(q)
    wanted = low + share * (high - low)
    try:
        theta = references.at(q, wanted)
    except UnreachableError:
        return
    assert device.torque_each(q, theta).sum() == pytest.approx(0.0, abs=1e-6)
    assert device.stiffness(q, theta) == pytest.approx(wanted, rel=1e-5)


def test_equal_springs_without_a_load_are_symmetric_about_the_angle():
    first, second = MotorReferences.from_device(DEVICE).at(0.2, 6.0)
    assert first + second == pytest.approx(0.4) and first > second
    assert MotorReferences.from_device(load_device("maccepavd")).at(0.2, 0.2)[0] == pytest.approx(0.2)


@pytest.mark.parametrize("stiffness", [1e3, 0.01, -1.0])
def test_an_unreachable_stiffness_raises(stiffness):
    with pytest.raises(UnreachableError, match=r"no stiffness .* 0\.0342 to 15\.97 N m/rad are reached"):
        MotorReferences.from_device(DEVICE).at(0.1, stiffness)


@pytest.mark.parametrize("name", ["visco_elastic_demo", "dfki_elbow"])
def test_joints_without_a_preset_are_refused(name):
    with pytest.raises(ParameterError, match="has no preset"):
        MotorReferences.from_device(load_device(name))


def test_servos_have_references_but_no_controller():
    with pytest.raises(ParameterError, match="no two motors that take torques"):
        EquilibriumPreset.from_device(load_device("maccepavd"))


def converged(controller, state, ticks, seen=None):
    """State, motor angles and torques with the link fixed at its reference: B thdd + D thd = tau + tau_e."""
    q, theta, speed, torques = state.equilibrium, np.array([0.1, -0.1]), np.zeros(2), []
    for tick in range(ticks):
        state, out = controller.step(state, JointSample(1e-3 * tick, q, theta))
        torques.append(out.torque)
        pull = DEVICE.torque_each(q, theta)
        speed = speed + 1e-3 / DEVICE.motors[0].inertia * (
            out.torque + pull - DEVICE.motors[0].viscous_friction * speed
        )
        theta = theta + 1e-3 * speed
    return state, theta, np.array(torques)


def test_motors_reach_the_target_without_a_jump_or_an_offset():
    controller = EquilibriumPreset.from_device(DEVICE)
    state, theta, torques = converged(controller, controller.with_reference(controller.init(), 0.2, 6.0), 1500)
    assert theta == pytest.approx(state.target, abs=1e-4)
    assert DEVICE.stiffness(0.2, theta) == pytest.approx(6.0, rel=2e-3)
    assert np.abs(torques).max() <= 6.0
    assert np.abs(np.diff(torques, axis=0)).max() < 2.0


def test_without_a_reference_or_a_valid_sample_the_joint_is_passive():
    controller = EquilibriumPreset.from_device(DEVICE)
    state, out = controller.step(controller.init(), JointSample(0.0, 0.0, np.zeros(2)))
    assert np.array_equal(out.torque, [0.0, 0.0])
    state = controller.with_reference(state, 0.1, 5.0)
    for sample in (JointSample(1e-3, np.nan, np.zeros(2)), JointSample(1e-3, 0.0, np.array([0.0, np.inf]))):
        after, out = controller.step(state, sample)
        assert after is state and np.array_equal(out.torque, [0.0, 0.0])


@given(st.floats(-1e6, 1e6), st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
@settings(deadline=None, max_examples=30)
def test_the_torque_limit_holds(time, first, second, q):
    controller = EquilibriumPreset.from_device(DEVICE)
    state = controller.with_reference(controller.init(), 0.1, 5.0)
    for k in range(3):
        state, out = controller.step(state, JointSample(time + k * 1e-3, q, np.array([first, second]) * (-1) ** k))
        assert np.abs(out.torque).max() <= 6.0


def at_rest(controller, wanted=6.0):
    state = controller.with_reference(controller.init(), 0.0, wanted)
    state, _ = controller.step(state, JointSample(0.0, 0.0, np.array(state.target)))
    return state


def with_estimates(controller, state, ratio, seconds, status=Status.OK, sd=0.0):
    """The state after estimates at 1 kHz of `ratio` times the model's stiffness."""
    for _ in range(1, round(1000 * seconds)):
        value = ratio * float(DEVICE.stiffness(state.q, state.theta))
        state = controller.with_estimate(state, state.time, status, value, sd * value)
        state, _ = controller.step(state, JointSample(state.time + 1e-3, 0.0, np.array(state.theta)))
    return state


def without_estimates(controller, state, seconds):
    for _ in range(round(1000 * seconds)):
        state, _ = controller.step(state, JointSample(state.time + 1e-3, 0.0, np.array(state.theta)))
    return state


def test_estimates_correct_the_spring_laws_until_they_agree():
    controller = EquilibriumPreset.from_device(DEVICE)
    state = with_estimates(controller, at_rest(controller), 1.15, 6.0)
    assert state.factor == pytest.approx(1.15, rel=1e-3) and state.reached
    assert 1.15 * DEVICE.stiffness(0.0, np.array(state.target)) == pytest.approx(6.0, rel=6e-3)
    once = with_estimates(controller, at_rest(controller), 1.15, 1.0)  # slowly: T = 1 s
    assert np.log(once.factor) == pytest.approx((1.0 - 3.0 * np.exp(-2.0)) * np.log(1.15), rel=0.01)


def test_bad_estimates_change_nothing_and_uncertain_ones_little():
    controller = EquilibriumPreset.from_device(DEVICE)
    for status in Status:
        if status != Status.OK:
            assert with_estimates(controller, at_rest(controller), 1.5, 1.0, status).factor == 1.0
    assert with_estimates(controller, at_rest(controller), np.nan, 1.0).factor == 1.0
    sure, unsure = (with_estimates(controller, at_rest(controller), 1.15, 1.0, sd=s).factor for s in (0.0, 0.3))
    assert 1.0 < unsure < 1.0 + 0.2 * (sure - 1.0)


@pytest.mark.parametrize("status", [None, *(each for each in Status if each != Status.OK)])
def test_without_an_estimate_that_is_ok_the_spring_laws_of_the_file_return(status):
    controller = replace(EquilibriumPreset.from_device(DEVICE), correction_time=0.2, fallback_time=0.3)
    state = with_estimates(controller, at_rest(controller), 1.15, 2.0)
    assert state.factor == pytest.approx(1.15, rel=1e-3)
    if status is None:
        after = without_estimates(controller, state, 0.9)  # a killed estimator
    else:
        after = with_estimates(controller, state, 1.5, 0.9, status)
    passed = 0.8 if status is None else 0.9  # [s]; silence is noticed after .1 s
    left = 1.5 * np.exp(-passed / 0.3) - 0.5 * np.exp(-passed / 0.1)  # two lags in series, of .3 and .1 s
    assert np.log(after.factor) == pytest.approx(left * np.log(1.15), rel=0.02)
    end = without_estimates(controller, after, 6.5)
    assert end.factor == 1.0 and end.target == pytest.approx(at_rest(controller).target, abs=1e-3)


def test_the_estimate_of_a_soft_joint_counts_as_well():
    controller = EquilibriumPreset.from_device(DEVICE)
    state = with_estimates(controller, at_rest(controller, 0.5), 1.15, 6.0)
    assert state.factor == pytest.approx(1.15, rel=1e-3)


def test_the_correction_of_a_wrong_estimate_is_bounded():
    controller = EquilibriumPreset.from_device(DEVICE)
    state = with_estimates(controller, at_rest(controller, 12.0), 0.01, 8.0)
    assert state.factor == pytest.approx(1.0 / LARGEST_FACTOR, rel=2e-3)
    assert not state.reached  # 36 N m/rad by the spring laws are out of reach: the closest stiffness
    assert DEVICE.stiffness(0.0, np.array(state.target)) == pytest.approx(15.97, rel=1e-3)
    with pytest.raises(UnreachableError):
        controller.with_reference(state, 0.0, 100.0)
    with pytest.raises(UnreachableError, match=r"equilibrium must lie in \[-10, 10\] rad, got 1e\+09"):
        controller.with_reference(state, 1e9, 5.0)


@pytest.mark.parametrize("change", [{"speed": 0.0}, {"correction_time": -1.0}, {"torque_limit": (1.0, 0.0)}])
def test_invalid_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(EquilibriumPreset.from_device(DEVICE), **change)
