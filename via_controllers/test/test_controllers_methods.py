"""The table of controllers: every entry builds its controller, limits it, and passes invalid samples through."""

import numpy as np
import pytest
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
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


@pytest.mark.parametrize("name", CONTROLLERS)
def test_an_invalid_sample_leaves_the_motors_passive(name):
    robot = CONTROLLERS[name]().build()
    before, _ = robot.supervisor.step(robot.supervisor.init(), zero_sample(robot, 0.0), active=True)
    after, answer = robot.supervisor.step(before, zero_sample(robot, np.nan), active=True)
    assert after is before and answer.activity is Activity.PASSIVE and not answer.torque.any()
