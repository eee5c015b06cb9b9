"""The gap monitor beside a robot that publishes /joint_states, or beside a bag that is played.

ros2 launch via_bringup gap.launch.py device:=/path/to/my_joint.yaml
ros2 launch via_bringup gap.launch.py device:=maccepavd bag:=/path/to/bag rate:=1.0
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
    playing = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    rate = ParameterValue(LaunchConfiguration("rate"), value_type=float)
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", description="device name or path to its YAML"),
            DeclareLaunchArgument("bag", default_value="", description="bag to play; empty: listen to the robot"),
            DeclareLaunchArgument("rate", default_value="1.0", description="playing speed"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", "gap.yaml"]),
                description="parameter file of the monitor",
            ),
            Node(
                package="via_gap",
                executable="gap_monitor",
                parameters=[LaunchConfiguration("parameters"), {"device": text("device")}],
                output="screen",
            ),
            Node(
                package="via_ros",
                executable="player",
                parameters=[{"bag": text("bag"), "rate": rate}],
                condition=playing,
                output="screen",
            ),
        ]
    )
