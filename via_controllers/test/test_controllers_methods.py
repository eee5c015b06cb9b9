"""The table of controllers: every entry builds its controller, limits it, and passes invalid samples through."""

import numpy as np
import pytest
from via_controllers.methods import CONTROLLERS
from via_controllers.robot import ControlledJoint
from via_controllers.supervision.arm_supervision import Activity


@pytest.mark.parametrize("name", CONTROLLERS)
def test_default_parameters_build_the_controller_of_the_table(name):
    method = CONTROLLERS[name]
    robot = method.parameters().build()
    controller = robot.supervisor.controller
    if isinstance(robot, ControlledJoint):
        controller = controller.controller
    assert isinstance(controller, method.controller)
    assert robot.command_topic == f"/{robot.name}/command"
    supervisor = robot.supervisor
    state, answer = supervisor.step(supervisor.init(), robot.zero_sample(0.0), active=True)
    limits = supervisor.limits.arm
    assert answer.activity is Activity.ACTIVE and answer.torque.shape == (limits.n,)
    assert (np.abs(answer.torque) <= limits.torque_limit).all()
    names = [quantity.name for quantity in supervisor.controller.quantities]
    assert len(supervisor.observe(state)) == len(set(names)) == len(names)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_an_invalid_sample_leaves_the_motors_passive(name):
    robot = CONTROLLERS[name].parameters().build()
    before, _ = robot.supervisor.step(robot.supervisor.init(), robot.zero_sample(0.0), active=True)
    after, answer = robot.supervisor.step(before, robot.zero_sample(np.nan), active=True)
    assert after is before and answer.activity is Activity.PASSIVE and not answer.torque.any()
