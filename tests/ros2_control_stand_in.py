"""What a stock controller_manager sends and receives, for machines without it: messages only, no controllers.

TopicHardware behaves as `joint_state_topic_hardware_interface`: it takes topics and joints from the URDF, names all
joints in a command, and lists efforts only of those with an effort command. The functions at the end are executables of
stand-in packages: robot_state_publisher, ros2_control_node and spawner.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String

DESCRIPTION = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TORQUE = 0.5  # [N m] on motor 1, and its negative on motor 2
UPDATE_RATE = 500  # [Hz] if the parameters have none


class TopicHardware:
    """The hardware interface in a node; `states` holds the last (position, velocity, effort) of every joint."""

    def __init__(self, node: Node, description: str) -> None:
        control = ElementTree.fromstring(description).find("ros2_control")
        urdf = {each.get("name") for each in ElementTree.fromstring(description).findall("joint")}
        plugin = control.findtext("hardware/plugin")
        assert plugin == "joint_state_topic_hardware_interface/JointStateTopicSystem"
        topics = {each.get("name"): each.text for each in control.findall("hardware/param")}
        self.names = [each.get("name") for each in control.findall("joint")]
        assert set(self.names) <= urdf, "the component parser of ros2_control refuses joints that the URDF lacks"
        commands = [(each.get("name"), each.find("command_interface")) for each in control.findall("joint")]
        self.commanded = [name for name, command in commands if command is not None]
        assert {command.get("name") for _, command in commands if command is not None} == {"effort"}
        self.states: dict[str, tuple[float, float, float]] = {}
        self._node = node
        self._publisher = node.create_publisher(JointState, topics["joint_commands_topic"], QoSProfile(depth=1))
        node.create_subscription(JointState, topics["joint_states_topic"], self._read, qos_profile_sensor_data)

    def _read(self, message: JointState) -> None:
        given = zip(message.name, message.position, message.velocity, message.effort, strict=True)
        self.states |= {name: values for name, *values in given if name in self.names}

    def write(self, efforts: np.ndarray) -> None:
        """Publish the commands of the joints that have them."""
        message = JointState(name=self.names, effort=efforts.tolist())
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def robot_state_publisher(node: Node) -> None:
    """Publishes its parameter as a latched topic."""
    text = node.declare_parameter("robot_description", "").value
    node.held = node.create_publisher(String, "/robot_description", DESCRIPTION)
    node.held.publish(String(data=text))


def ros2_control_node(node: Node) -> None:
    """Commands constant torques at the update rate once it has a description."""
    rate = node.declare_parameter("update_rate", UPDATE_RATE).value

    def begin(message: String) -> None:
        hardware = TopicHardware(node, message.data)
        node.create_timer(1.0 / rate, lambda: hardware.write(TORQUE * np.array([1.0, -1.0])))

    node.create_subscription(String, "/robot_description", begin, DESCRIPTION)


def spawner(node: Node) -> None:
    """Checks its arguments: names of controllers that the parameter file has."""
    *names, option, path = [each for each in sys.argv[1:] if each != "--ros-args"]
    assert option == "--param-file"
    assert all(f"{name}:\n  ros__parameters:" in Path(path).read_text(encoding="utf-8") for name in names)


def main(name: str) -> None:
    """Run one of the executables until it is interrupted."""
    rclpy.init()
    node = rclpy.create_node({"ros2_control_node": "controller_manager"}.get(name, name))
    globals()[name](node)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
