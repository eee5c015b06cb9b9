"""The hopper, dropped a little above the ground: it finds its own rhythm.

ros2 launch via_bringup hopper.launch.py
ros2 launch via_bringup hopper.launch.py payload:=6.0 bag:=hop

ros2 topic echo /hopper/base          # its trunk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def text(name: str) -> ParameterValue:
    """A launch argument as a text parameter, also where it looks like a number."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def generate_launch_description() -> LaunchDescription:
    file = LaunchConfiguration("parameters")
    payload = ParameterValue(LaunchConfiguration("payload"), value_type=float)
    recording = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument("payload", default_value="0.0", description="on the trunk [kg]"),
            DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
            DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", "hopper.yaml"]),
                description="parameter file of the nodes",
            ),
            Node(
                package="via_sim",
                executable="hopper_simulator",
                parameters=[file, {"payload": payload, "mode": text("mode")}],
                output="screen",
            ),
            Node(
                package="via_controllers",
                executable="hopping",
                parameters=[file],
                output="screen",
            ),
            Node(
                package="via_ros",
                executable="recorder",
                parameters=[{"bag": text("bag")}],
                condition=recording,
                output="screen",
            ),
        ]
    )
