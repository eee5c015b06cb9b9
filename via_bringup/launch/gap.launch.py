"""The gap monitor for a robot that publishes /joint_states, or for a bag that is played.

via launch gap device:=/path/to/my_joint.yaml
via launch gap device:=maccepavd bag:=/path/to/bag rate:=1.0
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, parameter_file, playback, string


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", description="device name or path to its YAML"),
            *playback(),
            parameter_file("gap.yaml", "parameter file of the gap monitor"),
            node("via_gap", "gap_monitor", LaunchConfiguration("parameters"), {"device": string("device")}),
        ]
    )
