"""Equilibrium and stiffness of a joint by its motors: springs inverted, motors led there, laws corrected."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from via_controllers.contract import JointSample
from via_controllers.equilibrium_preset import LARGEST_FACTOR, EquilibriumPreset
from via_controllers.motor_references import MotorReferences, UnreachableError, resting
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
    """`resting` by scipy and the device's own laws."""
    reach = min(law.max_deflection for law in device.spring_laws) - preset * (device.arrangement == "antagonistic")
    load = device.link.gravity_torque * np.sin(q - device.link.gravity_angle)

    def off(x):
        return float(device.torque_each(q, device.motor_angles(x, preset)).sum()) + load

    return q if abs(off(q)) < 1e-12 else brentq(off, q - reach, q + reach, xtol=1e-13)


def slow_at(references, q, stiffness):
    """`MotorReferences.at` likewise, where the ends of the presets enclose what is wanted."""
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
def test_the_compiled_search_answers_what_the_slow_one_does(name, q, share):
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
def test_levers_that_balance_nowhere_or_twice_give_a_right_answer_or_none(q, share):
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


def test_equal_springs_without_a_load_stand_about_the_angle():
    first, second = MotorReferences.from_device(DEVICE).at(0.2, 6.0)
    assert first + second == pytest.approx(0.4) and first > second
    assert MotorReferences.from_device(load_device("maccepavd")).at(0.2, 0.2)[0] == pytest.approx(0.2)


@pytest.mark.parametrize("stiffness", [1e3, 0.01, -1.0])
def test_what_cannot_be_reached_is_said(stiffness):
    with pytest.raises(UnreachableError, match=r"no stiffness .* 0\.0342 to 15\.97 N m/rad are reached"):
        MotorReferences.from_device(DEVICE).at(0.1, stiffness)


@pytest.mark.parametrize("name", ["visco_elastic_demo", "dfki_elbow"])
def test_joints_without_a_preset_are_refused(name):
    with pytest.raises(ParameterError, match="has no preset"):
        MotorReferences.from_device(load_device(name))


def test_servos_are_refused_by_the_law_but_have_references():
    with pytest.raises(ParameterError, match="no two motors that take torques"):
        EquilibriumPreset.from_device(load_device("maccepavd"))


def settled(law, state, ticks, seen=None):
    """Link held where it is wanted, motors without friction but their own: B thdd + D thd = tau + tau_e."""
    q, theta, speed, torques = state.equilibrium, np.array([0.1, -0.1]), np.zeros(2), []
    for tick in range(ticks):
        state, out = law.step(state, JointSample(1e-3 * tick, q, theta))
        torques.append(out.torque)
        pull = DEVICE.torque_each(q, theta)
        speed = speed + 1e-3 / DEVICE.motors[0].inertia * (
            out.torque + pull - DEVICE.motors[0].viscous_friction * speed
        )
        theta = theta + 1e-3 * speed
    return state, theta, np.array(torques)


def test_motors_get_there_without_a_jump_and_stay_without_an_offset():
    law = EquilibriumPreset.from_device(DEVICE)
    state, theta, torques = settled(law, law.towards(law.init(), 0.2, 6.0), 1500)
    assert theta == pytest.approx(state.target, abs=1e-4)
    assert DEVICE.stiffness(0.2, theta) == pytest.approx(6.0, rel=2e-3)
    assert np.abs(torques).max() <= 6.0
    assert np.abs(np.diff(torques, axis=0)).max() < 2.0


def test_nothing_wanted_or_seen_is_a_passive_joint():
    law = EquilibriumPreset.from_device(DEVICE)
    state, out = law.step(law.init(), JointSample(0.0, 0.0, np.zeros(2)))
    assert np.array_equal(out.torque, [0.0, 0.0])
    state = law.towards(state, 0.1, 5.0)
    for sample in (JointSample(1e-3, np.nan, np.zeros(2)), JointSample(1e-3, 0.0, np.array([0.0, np.inf]))):
        after, out = law.step(state, sample)
        assert after is state and np.array_equal(out.torque, [0.0, 0.0])


@given(st.floats(-1e6, 1e6), st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
@settings(deadline=None, max_examples=30)
def test_the_torque_limit_holds(time, first, second, q):
    law = EquilibriumPreset.from_device(DEVICE)
    state = law.towards(law.init(), 0.1, 5.0)
    for k in range(3):
        state, out = law.step(state, JointSample(time + k * 1e-3, q, np.array([first, second]) * (-1) ** k))
        assert np.abs(out.torque).max() <= 6.0


def at_rest(law, wanted=6.0):
    state = law.towards(law.init(), 0.0, wanted)
    state, _ = law.step(state, JointSample(0.0, 0.0, np.array(state.target)))
    return state


def told(law, state, ratio, seconds, status=Status.OK, deviation=0.0):
    """Estimates at 1 kHz that the joint is `ratio` times as stiff as the laws say."""
    for tick in range(1, round(1000 * seconds)):
        value = ratio * float(DEVICE.stiffness(state.q, state.theta))
        state = law.estimated(state, 1e-3 * tick, status, value, deviation * value)
    return state


def test_estimates_turn_the_laws_until_they_agree():
    law = EquilibriumPreset.from_device(DEVICE)
    state = told(law, at_rest(law), 1.15, 6.0)
    assert state.factor == pytest.approx(1.15, rel=1e-3) and state.reached
    assert 1.15 * DEVICE.stiffness(0.0, np.array(state.target)) == pytest.approx(6.0, rel=6e-3)
    once = told(law, at_rest(law), 1.15, 1.0)  # slowly: T = 1 s
    assert np.log(once.factor) == pytest.approx((1.0 - np.exp(-1.0)) * np.log(1.15), rel=0.01)


def test_bad_estimates_change_nothing_and_uncertain_ones_little():
    law = EquilibriumPreset.from_device(DEVICE)
    for status in Status:
        if status != Status.OK:
            assert told(law, at_rest(law), 1.5, 1.0, status).factor == 1.0
    assert told(law, at_rest(law), np.nan, 1.0).factor == 1.0
    sure, unsure = (told(law, at_rest(law), 1.15, 1.0, deviation=s).factor for s in (0.0, 0.3))
    assert 1.0 < unsure < 1.0 + 0.2 * (sure - 1.0)


def test_a_wild_estimate_moves_the_laws_no_further_than_they_can_be_wrong():
    law = EquilibriumPreset.from_device(DEVICE)
    state = told(law, at_rest(law, 12.0), 0.01, 8.0)
    assert state.factor == pytest.approx(1.0 / LARGEST_FACTOR, rel=2e-3)
    assert not state.reached  # 36 N m/rad by the laws are beyond their range: as far as they go
    assert DEVICE.stiffness(0.0, np.array(state.target)) == pytest.approx(15.97, rel=1e-3)
    with pytest.raises(UnreachableError):
        law.towards(state, 0.0, 100.0)


@pytest.mark.parametrize("change", [{"speed": 0.0}, {"correction_time": -1.0}, {"torque_limit": (1.0, 0.0)}])
def test_silly_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(EquilibriumPreset.from_device(DEVICE), **change)
