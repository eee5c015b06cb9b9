"""Serialised commands and control states of arms and joints."""

from __future__ import annotations

import array

import numpy as np
from via_core.signals import Array
from via_interfaces.msg import ControlState, VsaCommand
from via_ros.conversions import Command
from via_ros.interfaces import stamp_bytes
from via_ros.serialised import CommandBytes, Template

from via_controllers.robot import Controlled
from via_controllers.supervision.arm_limits import Limit
from via_controllers.supervision.arm_supervision import Answer


class AnswerWriter:
    """Writes the messages of a robot, each kind numbered from 0. Stamps [ns] are those of samples.

    method  name of the controller
    limits  of the motors, as texts
    """

    def __init__(self, robot: Controlled, method: str) -> None:
        arm, quantities = robot.supervisor.limits.arm, robot.supervisor.controller.quantities
        limits = {
            "torque_limit": arm.torque_limit,
            "speed_limit": arm.speed_limit,
            "deflection_limit": arm.deflection_limit,
        }
        self.limits = {name: " ".join(f"{value:g}" for value in values) for name, values in limits.items()}
        message = ControlState(
            method=method,
            name=[each.name for each in quantities],
            unit=[each.unit for each in quantities],
            value=array.array("d", [np.nan] * len(quantities)),
            **{name: array.array("d", values) for name, values in limits.items()},
        )
        message.header.frame_id = robot.name
        self._template = Template(message)
        self._value = self._template.view("value")
        self._sequence = 0
        self._commands, self._damping = CommandBytes(robot.name), robot.damping

    def command(self, stamp: int, torque: Array) -> bytes:
        """The VsaCommand of motor torques (n,) [N m]."""
        return self._commands.numbered(stamp, Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, self._damping, torque))

    def state(self, stamp: int, answer: Answer, values: Array) -> bytes:
        """The ControlState of an answer and the quantities (k,) of the controller."""
        self._value[:] = values
        sequence, self._sequence = self._sequence, self._sequence + 1
        return self._template.numbered(stamp_bytes(stamp), sequence, bytes((answer.activity, answer.limited)))


def limit_names(bits: int) -> str:
    """Names of the limits in bits of Limit."""
    return ", ".join(each.name.lower() for each in Limit if each & bits and each.name) or "none"
