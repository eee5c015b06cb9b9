"""A flexible joint whose link is as fast as can be at a given time.

ros2 launch via_bringup throw.launch.py
ros2 launch via_bringup throw.launch.py mode:=lockstep bag:=throw

Once more: ros2 lifecycle set /max_velocity deactivate, then activate
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
    device = text("device")
    recording = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "device", default_value="visco_elastic_demo", description="device or path to its YAML"
            ),
            DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
            DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", "throw.yaml"]),
                description="parameter file of the nodes",
            ),
            Node(
                package="via_sim",
                executable="simulator",
                parameters=[file, {"device": device, "mode": text("mode")}],
                output="screen",
            ),
            Node(
                package="via_controllers",
                executable="max_velocity",
                parameters=[file, {"device": device}],
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
