"""Node `commanded_torque`: motor torques from a JointState, as the topic hardware interface of ros2_control sends them.

ros2 run via_controllers commanded_torque --ros-args -p device:=qbmove_a

subscribes  /<device>/joint_commands  sensor_msgs/JointState, efforts of all drives by joint name

Other topics and the lifecycle: see `controller`. Limits and supervision are those of every controller. 20 ms after the
last command the torque is zero (`timeout`). /<device>/control reports the commanded torques and their age.
"""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import JointState
from via_ros import qos
from via_ros.conversions import efforts_of

from via_controllers.joint_methods import CommandedTorqueParameters
from via_controllers.nodes.controller import ControllerNode, Input
from via_controllers.robot import ControlledJoint


class CommandedTorqueNode(ControllerNode):
    """The controller node with an input for efforts."""

    def __init__(self, **options: Any) -> None:
        super().__init__("commanded_torque", self._connected, **options)

    def _connected(self, parameters: CommandedTorqueParameters) -> tuple[ControlledJoint, tuple[Input, ...]]:
        robot = parameters.build()
        controller, joints = parameters.controller(robot.axes), robot.axes.device.drive_joints

        def command(message: JointState) -> None:
            torque = efforts_of(message, joints)
            self.update(lambda state: controller.with_torque(state, torque))

        return robot, ((JointState, f"{robot.name}/joint_commands", command, qos.LOOP),)
