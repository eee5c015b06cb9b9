"""All controllers by name. Nodes, executables (setup.py) and node parameters are derived from this table."""

from __future__ import annotations

from typing import Any, NamedTuple

from via_controllers.arm_methods import BangBangParameters, HoppingParameters, ModalLimitCycleParameters
from via_controllers.arms.bang_bang import ModalBangBang
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.contract import ArmController, Controller
from via_controllers.joint_methods import (
    BangBangJointParameters,
    EquilibriumPresetParameters,
    ExcitationParameters,
    MaxVelocityParameters,
)
from via_controllers.joints.bang_bang_joint import JointBangBang
from via_controllers.joints.equilibrium_preset import EquilibriumPreset
from via_controllers.joints.max_velocity import MaxVelocity
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.robot import ControllerParameters


class Method(NamedTuple):
    """A controller's class and the parameters that build it for an arm or a joint."""

    controller: type[Controller[Any]] | type[ArmController[Any]]
    parameters: type[ControllerParameters]


CONTROLLERS: dict[str, Method] = {
    "excitation": Method(MotorPositionControl, ExcitationParameters),
    "equilibrium_preset": Method(EquilibriumPreset, EquilibriumPresetParameters),
    "bang_bang_joint": Method(JointBangBang, BangBangJointParameters),
    "max_velocity": Method(MaxVelocity, MaxVelocityParameters),
    "modal_limit_cycle": Method(VsaModalLimitCycle, ModalLimitCycleParameters),
    "bang_bang": Method(ModalBangBang, BangBangParameters),
    "hopping": Method(ModalBangBang, HoppingParameters),
}
