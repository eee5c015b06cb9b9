"""An estimator for a robot that publishes /joint_states, or for a bag that is played.

via launch estimate device:=/path/to/my_joint.yaml
via launch estimate device:=maccepavd bag:=/path/to/bag rate:=1.0
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from via_bringup.launching import node, playback, string


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", description="device name or path to its YAML"),
            DeclareLaunchArgument("method", default_value="auto", description="auto or the name of an estimator"),
            *playback("playback speed; 0: as fast as the subscribers keep up"),
            node("via_estimators", "estimator", {"device": string("device"), "method": string("method")}),
        ]
    )
