"""The 4-dof arm swings against a wall by motors that switch; nothing in the law knows of the wall.

ros2 launch via_bringup hitting.launch.py
ros2 launch via_bringup hitting.launch.py mode:=lockstep bag:=hitting

ros2 topic echo /reference_4dof/contact
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
    recording = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
            DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", "hitting.yaml"]),
                description="parameter file of the nodes",
            ),
            Node(
                package="via_sim",
                executable="arm_simulator",
                parameters=[file, {"mode": text("mode")}],
                output="screen",
            ),
            Node(
                package="via_controllers",
                executable="bang_bang",
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
