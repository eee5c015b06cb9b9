"""All controllers by name, with the parameters that build them. Nodes and executables (setup.py) follow this table."""

from __future__ import annotations

from via_controllers.arm_methods import BangBangParameters, HoppingParameters, ModalLimitCycleParameters
from via_controllers.joint_methods import (
    BangBangJointParameters,
    CommandedTorqueParameters,
    EquilibriumPresetParameters,
    ExcitationParameters,
    MaxVelocityParameters,
)
from via_controllers.robot import ControllerParameters

CONTROLLERS: dict[str, type[ControllerParameters]] = {
    "excitation": ExcitationParameters,
    "equilibrium_preset": EquilibriumPresetParameters,
    "bang_bang_joint": BangBangJointParameters,
    "max_velocity": MaxVelocityParameters,
    "commanded_torque": CommandedTorqueParameters,
    "modal_limit_cycle": ModalLimitCycleParameters,
    "bang_bang": BangBangParameters,
    "hopping": HoppingParameters,
}
