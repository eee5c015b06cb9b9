"""A flexible joint that reaches the highest possible link velocity at a given time.

via launch throw
via launch throw mode:=lockstep bag:=throw

To repeat the throw: via lifecycle set /max_velocity deactivate, then activate
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, simulation, string


def generate_launch_description() -> LaunchDescription:
    file, device = LaunchConfiguration("parameters"), string("device")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "device", default_value="visco_elastic_demo", description="device name or path to its YAML"
            ),
            *simulation("throw.yaml"),
            node("via_sim", "simulator", file, {"device": device, "mode": string("mode")}),
            node("via_controllers", "max_velocity", file, {"device": device}),
        ]
    )
