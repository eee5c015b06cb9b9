"""A two-legged hopper that is dropped from just above the ground and settles into periodic hopping.

ros2 launch via_bringup hopper.launch.py
ros2 launch via_bringup hopper.launch.py payload:=6.0 bag:=hop

ros2 topic echo /hopper/base          # pose of the trunk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import float_argument, node, simulation, string_argument


def generate_launch_description() -> LaunchDescription:
    file = LaunchConfiguration("parameters")
    return LaunchDescription(
        [
            DeclareLaunchArgument("payload", default_value="0.0", description="mass added to the trunk [kg]"),
            *simulation("hopper.yaml"),
            node("via_sim", "hopper_simulator", file, {"payload": float_argument("payload"), "mode": string_argument("mode")}),
            node("via_controllers", "hopping", file),
        ]
    )
