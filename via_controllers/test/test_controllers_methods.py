"""The table of controllers: every entry builds its controller, limits it, and passes invalid samples through."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.contract import ArmController, passive
from via_controllers.joints.bang_bang_joint import JointBangBang
from via_controllers.joints.commanded_torque import CommandedTorque
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_controllers.joints.max_velocity import MaxVelocity
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.methods import CONTROLLERS
from via_controllers.robot import ControlledJoint, zero_sample
from via_controllers.supervision.arm_supervision import Activity

KINDS = {
    "excitation": MotorPositionControl,
    "equilibrium_preset": EquilibriumPreset,
    "bang_bang_joint": JointBangBang,
    "max_velocity": MaxVelocity,
    "commanded_torque": CommandedTorque,
    "modal_limit_cycle": VsaModalLimitCycle,
    "bang_bang": ModalBangBang,
    "hopping": ModalBangBang,
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_default_parameters_build_the_controller(name):
    robot = CONTROLLERS[name]().build()
    controller = robot.supervisor.controller
    if isinstance(robot, ControlledJoint):
        controller = controller.controller
    assert isinstance(controller, KINDS[name])
    assert robot.command_name == f"{robot.name}/command"
    supervisor = robot.supervisor
    state, answer = supervisor.step(supervisor.init(), zero_sample(robot, 0.0), active=True)
    limits = supervisor.limits.arm
    assert answer.activity is Activity.ACTIVE and answer.torque.shape == (limits.n,)
    assert (np.abs(answer.torque) <= limits.torque_limit).all()
    names = [quantity.name for quantity in supervisor.controller.quantities]
    assert len(supervisor.observe(state)) == len(set(names)) == len(names)


def values(part):
    """The numbers and arrays of a dataclass and of those in it, by their place."""
    if not is_dataclass(part):
        return {"": part}
    found = {each.name: values(getattr(part, each.name)) for each in fields(part) if each.init}
    return {f"{name}.{inner}": value for name, all_inner in found.items() for inner, value in all_inner.items()}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_live_parameters_lead_to_the_controller_that_they_build(name):
    settings = CONTROLLERS[name]()
    live = [each.name for each in fields(settings) if each.metadata.get("live")]
    changed = replace(settings, **{each: 0.5 * getattr(settings, each) for each in live})
    supervisor = changed.tuned(settings.build().supervisor)
    tuned, built = (values(each.controller) for each in (supervisor, changed.build().supervisor))
    assert tuned.keys() == built.keys()
    for place, value in built.items():
        if isinstance(value, float | int | np.ndarray):
            np.testing.assert_allclose(tuned[place], value, rtol=1e-12, err_msg=place)
        else:
            assert type(tuned[place]) is type(value), place
    robot = settings.build()
    assert supervisor.step(supervisor.init(), zero_sample(robot, 0.0), active=True)[1].activity is Activity.ACTIVE


class Failing(ArmController):
    """Fails in the way of a programmer."""

    quantities = ()

    def init(self, sample):
        raise TypeError("no number")

    def observe(self, state):
        return np.empty(0)

    def step(self, state, sample):
        return state, passive(len(sample.theta))


def test_a_controller_that_fails_in_any_way_leaves_the_motors_passive():
    robot = CONTROLLERS["bang_bang"]().build()
    supervisor = replace(robot.supervisor, controller=Failing())
    _, answer = supervisor.step(supervisor.init(), zero_sample(robot, 0.0), active=True)
    assert not answer.torque.any() and "fails on a sample: TypeError: no number" in answer.fault


@pytest.mark.parametrize("name", CONTROLLERS)
def test_an_invalid_sample_leaves_the_motors_passive(name):
    robot = CONTROLLERS[name]().build()
    before, _ = robot.supervisor.step(robot.supervisor.init(), zero_sample(robot, 0.0), active=True)
    after, answer = robot.supervisor.step(before, zero_sample(robot, np.nan), active=True)
    assert after is before and answer.activity is Activity.PASSIVE and not answer.torque.any()
