"""A two-legged hopper, dropped from just above the ground. No hopping frequency is prescribed.

via launch hopper
via launch hopper payload:=6.0 bag:=hop

via topic echo /hopper/base          # pose of the trunk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, number, simulation, string


def generate_launch_description() -> LaunchDescription:
    file = LaunchConfiguration("parameters")
    return LaunchDescription(
        [
            DeclareLaunchArgument("payload", default_value="0.0", description="mass added to the trunk [kg]"),
            *simulation("hopper.yaml"),
            node("via_sim", "hopper_simulator", file, {"payload": number("payload"), "mode": string("mode")}),
            node("via_controllers", "hopping", file),
        ]
    )
