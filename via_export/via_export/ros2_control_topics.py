"""A device for a stock controller_manager that drives it over topics: the robot as URDF, and the controllers as YAML.

The hardware is `joint_state_topic_hardware_interface`. It reads /joint_states and publishes the efforts of the motors
as a JointState on /<device>/joint_commands, which node `commanded_torque` turns into commands of the device. Motors are
joints of the URDF, too, because ros2_control refuses joints that the URDF lacks.
Source: README and source of ros-controls/topic_based_hardware_interfaces; component parser of ros2_control (Jazzy).
"""

from __future__ import annotations

from typing import Any

import yaml
from via_core.devices import Device
from via_core.errors import ParameterError
from via_sim.joint.parameters import LINK

from via_export import urdf
from via_export.ros2_control import command, joint, parameter
from via_export.target import Target
from via_export.xml import document, element, leaf

PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
UPDATE_RATE = 500  # [Hz]; a command acts for 20 ms
BROADCASTER, TORQUES = "joint_state_broadcaster", "motor_torques"  # names of the controllers


def command_topic(device: Device) -> str:
    """Topic on which the hardware interface publishes."""
    return f"/{device.name}/joint_commands"


def robot(device: Device) -> str:
    """URDF with the element `ros2_control`. Raises ParameterError for a device without torque motors."""
    if device.drive != "torque" or not device.n_motors:
        raise ParameterError(f"device: ros2_control commands torques of motors; '{device.name}' has no such motors")
    target = Target.of(device)
    root = urdf.robot(target)
    axis = next(root.iter("axis")).get("xyz", "")
    for name in device.motor_joints:
        parts = (element("parent", link=f"{device.name}_base"), element("child", link=f"{name}_rotor"))
        root.append(element("link", name=f"{name}_rotor"))
        root.append(element("joint", *parts, element("axis", xyz=axis), name=name, type="continuous"))
    parameters: dict[str, str | float] = {
        "joint_commands_topic": command_topic(device),
        "joint_states_topic": "/joint_states",
        "trigger_joint_command_threshold": -1.0,  # always: the default leaves out commands near the measured position
    }
    hardware = element("hardware", leaf("plugin", PLUGIN), *(parameter(*each) for each in parameters.items()))
    driven = [
        joint(target.names[axis], command("effort", -target.limit(axis), target.limit(axis))) for axis in target.drives
    ]
    root.append(element("ros2_control", hardware, *driven, joint(target.names[LINK]), name=device.name, type="system"))
    return document(root, declaration=True)


def controllers(device: Device) -> str:
    """YAML for the controller_manager: a broadcaster of states, and a controller that forwards torques of the motors.

    The broadcaster uses topics of its own, because the samples of the device are on /joint_states.
    """
    types = {
        BROADCASTER: "joint_state_broadcaster/JointStateBroadcaster",
        TORQUES: "forward_command_controller/ForwardCommandController",
    }
    content: dict[str, dict[str, Any]] = {
        "controller_manager": {"update_rate": UPDATE_RATE, **{name: {"type": kind} for name, kind in types.items()}},
        BROADCASTER: {"use_local_topics": True},
        TORQUES: {"joints": list(device.motor_joints), "interface_name": "effort"},
    }
    return yaml.safe_dump({name: {"ros__parameters": each} for name, each in content.items()}, sort_keys=False)
