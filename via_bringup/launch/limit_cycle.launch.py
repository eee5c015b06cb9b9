"""A simulated arm of flexible joints that swings on one of its modes; push it, hold it, let it go.

ros2 launch via_bringup limit_cycle.launch.py
ros2 launch via_bringup limit_cycle.launch.py law:=bang_bang mode:=lockstep bag:=swing

ros2 service call /arm_simulator/push via_interfaces/srv/Push "{impulse: [0.3, 0.3, 0.1, 0.1]}"
ros2 service call /arm_simulator/hold via_interfaces/srv/Hold "{duration: 1.0}"
ros2 lifecycle set /modal_limit_cycle deactivate
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


def when(name: str, value: str) -> IfCondition:
    """Whether an argument has this value."""
    return IfCondition(PythonExpression(["'", LaunchConfiguration(name), f"' == '{value}'"]))


def generate_launch_description() -> LaunchDescription:
    file, arm = LaunchConfiguration("parameters"), text("arm")
    defaults = PythonExpression(["'", LaunchConfiguration("law"), "' + '.yaml'"])
    recording = IfCondition(PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"]))
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="reference_4dof", description="arm or path to its YAML"),
            DeclareLaunchArgument("law", default_value="modal_limit_cycle", description="modal_limit_cycle, bang_bang"),
            DeclareLaunchArgument("mode", default_value="realtime", description="realtime, lockstep or free"),
            DeclareLaunchArgument("bag", default_value="", description="folder of the bag to record; empty: none"),
            DeclareLaunchArgument(
                "parameters",
                default_value=PathJoinSubstitution([FindPackageShare("via_bringup"), "config", defaults]),
                description="parameter file of the nodes; else that of the law",
            ),
            Node(
                package="via_sim",
                executable="arm_simulator",
                parameters=[file, {"arm": arm, "mode": text("mode")}],
                output="screen",
            ),
            Node(
                package="via_controllers",
                executable="modal_limit_cycle",
                parameters=[file, {"arm": arm}],
                condition=when("law", "modal_limit_cycle"),
                output="screen",
            ),
            Node(
                package="via_controllers",
                executable="bang_bang",
                parameters=[file, {"arm": arm}],
                condition=when("law", "bang_bang"),
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
