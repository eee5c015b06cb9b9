"""The limit cycle with a corrected model: whose torques it commands, and how it uses estimates."""

from __future__ import annotations

from dataclasses import replace
from math import log

import numpy as np
import pytest
from via_controllers.arm_methods import ModalLimitCycleParameters
from via_controllers.contract import ArmSample
from via_controllers.correction import Correction
from via_core.status import Status

PARAMETERS = ModalLimitCycleParameters(adapt=True, correction_time=0.2, fallback_time=0.3)
CONTROLLER = PARAMETERS.adaptive()
ARM = CONTROLLER.arm
REST = np.array(PARAMETERS.equilibrium)
PHI = REST - ARM.rest(REST) + np.array([0.002, -0.001, 0.003, 0.001])  # [rad] springs nearly bear the weight
RATE = np.array([0.1, -0.08, 0.06, 0.07])  # [rad/s]
PAYLOAD, SCALE = 0.05, np.array([0.98, 1.02, 0.97, 1.03])  # so small that no torque is at its limit
FRICTION = np.array([0.2, 0.05, 0.3, 0.1])  # [N m s/rad]
NONE = np.zeros(4)


def sample_at(time=0.0):
    return ArmSample(time, REST, 0.5 * RATE, REST - PHI, -0.5 * RATE, np.full(4, np.nan))


def started(time=0.0):
    return CONTROLLER.init(sample_at(time))


def held_at(state, payload, friction, logs):
    """`state` with a constant correction."""
    fixed = tuple(Correction(each, each, each, 1.0, state.swing.time) for each in (payload, *friction, *logs))
    return replace(state, payload=fixed[0], friction=fixed[1:5], springs=fixed[5:])


def test_without_a_correction_it_is_the_published_controller():
    state, torques = CONTROLLER.step(started(), sample_at(1e-3))
    _, published = CONTROLLER.published.step(CONTROLLER.published.init(sample_at()), sample_at(1e-3))
    assert np.array_equal(torques.torque, published.torque)
    assert CONTROLLER.controller_for(state.payload, state.friction, state.springs) is CONTROLLER.published
    assert CONTROLLER.model(state) is ARM


@pytest.mark.parametrize(
    ("payload", "friction", "scale"),
    [(PAYLOAD, FRICTION, SCALE), (PAYLOAD, NONE, np.ones(4)), (0.0, NONE, SCALE), (0.0, FRICTION, np.ones(4))],
)
def test_a_correction_is_the_published_controller_on_the_corrected_arm(payload, friction, scale):
    state, torques = CONTROLLER.step(held_at(started(), payload, friction, np.log(scale)), sample_at(1e-3))
    real = ARM.corrected(payload, scale, friction)
    assert real.link_friction == pytest.approx(ARM.link_friction + friction)
    model = CONTROLLER.model(state)
    assert np.array_equal(model.link_friction, real.link_friction)
    assert model.spring_scale == pytest.approx(real.spring_scale) and np.array_equal(
        model.gravity(REST), real.gravity(REST)
    )
    cycle = replace(CONTROLLER.published.cycle, arm=real)
    expected = replace(CONTROLLER.published, cycle=cycle)
    _, published = expected.step(CONTROLLER.published.init(sample_at()), sample_at(1e-3))
    assert torques.torque == pytest.approx(published.torque, rel=1e-9)
    nominal = CONTROLLER.step(started(), sample_at(1e-3))[1]
    assert not torques.saturated and np.abs(torques.torque - nominal.torque).max() > 0.5
    assert CONTROLLER.observe(state)[-9:] == pytest.approx([payload, *friction, *scale])
    names = [each.name for each in CONTROLLER.quantities]
    each_joint = [f"{name}_{joint}" for name in ("link_friction", "spring_scale") for joint in range(1, 5)]
    assert names[-9:] == ["payload", *each_joint]
    assert len(names) == len(CONTROLLER.observe(state))


def test_a_step_corrects_by_the_time_that_passed():
    informed = CONTROLLER.with_payload(started(2.0), 2.0, Status.OK, np.array([PAYLOAD, *FRICTION]), np.zeros(5))
    informed = replace(informed, springs=(Correction(0.1, 0.1, 0.0, 0.0), *informed.springs[1:]))
    after, _ = CONTROLLER.step(informed, sample_at(2.0625))
    assert after.payload == CONTROLLER.payload_rule.advanced(informed.payload, 2.0625, 0.0625) != informed.payload
    friction = tuple(CONTROLLER.friction_rule.advanced(each, 2.0625, 0.0625) for each in informed.friction)
    assert after.friction == friction != informed.friction
    assert (
        after.springs[0] == CONTROLLER.spring_rule.advanced(informed.springs[0], 2.0625, 0.0625) != informed.springs[0]
    )
    back, _ = CONTROLLER.step(informed, sample_at(1.95))  # a stamp that goes backward
    assert back.payload.value == informed.payload.value
    assert after.deflection == pytest.approx(PHI) and after.deflection_rate == pytest.approx(RATE)


def test_an_invalid_sample_is_passive_and_changes_nothing():
    state = held_at(started(), PAYLOAD, FRICTION, np.log(SCALE))
    after, torques = CONTROLLER.step(state, replace(sample_at(1e-3), q=np.full(4, np.nan)))
    assert after is state and np.array_equal(torques.torque, np.zeros(4))


def test_payload_and_friction_are_bounded_by_their_rules():
    sd = np.array([PARAMETERS.trusted_payload, *np.full(4, PARAMETERS.trusted_friction)])
    informed = CONTROLLER.with_payload(started(), 0.1, Status.OK, np.full(5, 1e3), sd)
    assert informed.payload == Correction(0.0, 0.0, PARAMETERS.heaviest, 0.5, 0.1)
    assert informed.friction == (Correction(0.0, 0.0, PARAMETERS.most_friction, 0.5, 0.1),) * 4
    less = CONTROLLER.with_payload(informed, 0.2, Status.OK, np.full(5, -1e3), np.zeros(5))
    assert less.payload.estimate == 0.0 and {each.estimate for each in less.friction} == {-PARAMETERS.most_friction}


def test_friction_that_is_not_known_leaves_the_payload_in_use():
    value, sd = np.array([PAYLOAD, 0.1, np.nan, 0.1, 0.1]), np.array([0.0, 0.0, 0.0, np.nan, 0.0])
    informed = CONTROLLER.with_payload(started(), 0.1, Status.OK, value, sd)
    assert informed.payload.weight == 1.0 and [each.weight for each in informed.friction] == [1.0, 0.0, 0.0, 1.0]


def test_links_of_the_model_never_drive():
    """The arm's file has no friction that could be less."""
    state, _ = CONTROLLER.step(held_at(started(), PAYLOAD, -FRICTION, NONE), sample_at(1e-3))
    assert np.array_equal(CONTROLLER.model(state).link_friction, ARM.link_friction) and not ARM.link_friction.any()


@pytest.mark.parametrize("lead", [0.0, 0.05])
def test_a_predicted_sample_is_compared_with_estimates_by_its_stamp(lead):
    """Predicted by 50 ms: the deflection then was that of now, less what the prediction adds."""
    sample = replace(sample_at(1.0 + lead), lead=lead)
    state = CONTROLLER.init(sample)
    nominal = ARM.spring_state(PHI - (lead + 0.01) * RATE)[1][0]
    found = CONTROLLER.with_stiffness(state, 0, 0.99, Status.OK, 0.9 * nominal, 0.0).springs[0]
    assert found.estimate == pytest.approx(log(0.9)) and found.weight == 1.0
    informed = CONTROLLER.with_payload(state, 1.0, Status.OK, np.full(5, 0.1), np.zeros(5))
    later, _ = CONTROLLER.step(informed, replace(sample_at(1.05 + lead), lead=lead))
    assert later.measured == pytest.approx(1.05)
    expected = CONTROLLER.payload_rule.advanced(informed.payload, later.measured, 0.05)
    assert later.payload.value == pytest.approx(expected.value) and expected.value > 0.01


@pytest.mark.parametrize("age", [0.0, 0.019, -0.019])
@pytest.mark.parametrize("joint", range(4))
def test_a_stiffness_is_compared_with_that_of_the_file_at_its_own_time(joint, age):
    state = started(1.0)
    nominal = ARM.spring_state(PHI - age * RATE)[1][joint]
    sd = PARAMETERS.trusted_deviation * 0.8 * nominal
    informed = CONTROLLER.with_stiffness(state, joint, 1.0 - age, Status.OK, 0.8 * nominal, sd)
    found = informed.springs[joint]
    assert found.estimate == pytest.approx(log(0.8)) and found.weight == pytest.approx(0.5)
    assert found.stamp == 1.0 - age
    others = [each for k, each in enumerate(informed.springs) if k != joint]
    assert others == [Correction()] * 3 and informed.payload == Correction()


@pytest.mark.parametrize(
    ("age", "status", "value"),
    [(0.021, Status.OK, 80.0), (-0.021, Status.OK, 80.0), (0.0, Status.OK, -80.0),
     (0.0, Status.OK, 0.0), (0.0, Status.OK, np.nan), (0.0, Status.NOT_EXCITED, 80.0), (0.0, Status.IMPLAUSIBLE, 80.0)],
)  # fmt: skip
def test_old_impossible_and_doubtful_stiffnesses_are_not_used(age, status, value):
    state = held_at(started(), 0.0, NONE, np.full(4, 0.1))
    state = replace(state, measured=1.0, swing=replace(state.swing, time=1.0))
    informed = CONTROLLER.with_stiffness(state, 2, 1.0 - age, status, value, 0.1)
    assert informed.springs[2].weight == 0.0 and informed.springs[2].estimate == 0.1


def test_a_wild_stiffness_is_bounded():
    informed = CONTROLLER.with_stiffness(started(), 1, 0.0, Status.OK, 1e9, 0.0)
    assert informed.springs[1].estimate == pytest.approx(log(3.0))
    informed = CONTROLLER.with_stiffness(started(), 1, 0.0, Status.OK, 1e-9, 0.0)
    assert informed.springs[1].estimate == pytest.approx(-log(3.0))
