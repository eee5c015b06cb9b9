"""A simulated or real joint under a stock controller_manager, with stiffness and damping on /dynamic_joint_states.

via launch ros2_control device:=qbmove_a
via launch ros2_control device:=/path/to/my_joint.yaml simulated:=false files:=my_joint

ros2 topic pub -r 100 /motor_torques/commands std_msgs/msg/Float64MultiArray "{data: [0.5, -0.5]}"

`files` keeps description and controllers file for editing; files that are there already are used as they are. Without
the packages of ros2_control the other nodes start, and a line names what is missing.
"""

from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.parameter_descriptions import ParameterValue
from via_bringup.launching import missing, node, simulation, string
from via_core.devices import load_device
from via_export import ros2_control_topics as topics

MANAGER = (
    "controller_manager", "joint_state_topic_hardware_interface", "joint_state_broadcaster",
    "forward_command_controller", "robot_state_publisher",
)  # fmt: skip
MESSAGES = "control_msgs"


def manager(context: LaunchContext) -> list[Any]:
    """The controller_manager with its controllers, and the node for /dynamic_joint_states, as far as installed."""
    device = load_device(LaunchConfiguration("device").perform(context))
    folder = Path(LaunchConfiguration("files").perform(context) or mkdtemp(prefix="via_ros2_control_"))
    folder.mkdir(parents=True, exist_ok=True)
    description, controllers = folder / f"{device.name}.urdf", folder / f"{device.name}_controllers.yaml"
    for path, text in ((description, topics.robot(device)), (controllers, topics.controllers(device))):
        if not path.exists():
            path.write_text(text, encoding="utf-8")
    lacking = missing((*MANAGER, MESSAGES))
    made: list[Any] = []
    if MESSAGES not in lacking:
        made.append(node("via_estimators", "dynamic_joint_states", {"device": string("device")}))
    if not set(MANAGER) & set(lacking):
        spawned = [topics.BROADCASTER, topics.TORQUES, "--param-file", str(controllers)]
        described = {"robot_description": ParameterValue(description.read_text(encoding="utf-8"), value_type=str)}
        made += [
            node("robot_state_publisher", "robot_state_publisher", described),
            node("controller_manager", "ros2_control_node", str(controllers)),
            node("controller_manager", "spawner", arguments=spawned),
        ]
    if lacking:
        packages = " ".join(f"ros-jazzy-{each.replace('_', '-')}" for each in lacking)
        made.append(LogInfo(msg=f"ros2_control is not complete; on a stock Jazzy: sudo apt install {packages}"))
    return made


def generate_launch_description() -> LaunchDescription:
    file, device = LaunchConfiguration("parameters"), string("device")
    simulated = {"device": device, "mode": string("mode"), "effects": string("effects")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", default_value="qbmove_a", description="device name or path to its YAML"),
            DeclareLaunchArgument("simulated", default_value="true", description="false: for a real joint"),
            DeclareLaunchArgument("effects", default_value="", description="effects file for the simulator"),
            DeclareLaunchArgument(
                "files", default_value="", description="folder of description and controllers; empty: temporary"
            ),
            *simulation("joint.yaml"),
            node("via_sim", "simulator", file, simulated, condition=IfCondition(LaunchConfiguration("simulated"))),
            node("via_controllers", "commanded_torque", file, {"device": device}),
            node("via_estimators", "estimator", file, {"device": device}),
            OpaqueFunction(function=manager),
        ]
    )
