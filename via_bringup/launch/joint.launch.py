"""A simulated joint with its controller, its estimator and, if asked, a recorder.

ros2 launch via_bringup joint.launch.py device:=cubic_aa_vsa bag:=joint
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    device = {"device": LaunchConfiguration("device")}
    parameters = [LaunchConfiguration("parameters"), device]
    recording = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", default_value="cubic_aa_vsa", description="device or path to its YAML"),
            DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
            DeclareLaunchArgument("effects", default_value="", description="effects file the simulator adds"),
            DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", "joint.yaml"]),
                description="parameter file of the nodes",
            ),
            Node(
                package="via_sim",
                executable="simulator",
                parameters=[
                    *parameters,
                    {"mode": LaunchConfiguration("mode"), "effects": LaunchConfiguration("effects")},
                ],
                output="screen",
            ),
            Node(package="via_controllers", executable="excitation", parameters=parameters, output="screen"),
            Node(package="via_estimators", executable="estimator", parameters=parameters, output="screen"),
            Node(
                package="via_ros",
                executable="recorder",
                parameters=[*parameters, {"bag": LaunchConfiguration("bag")}],
                condition=recording,
                output="screen",
            ),
        ]
    )
