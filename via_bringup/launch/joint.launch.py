"""A simulated joint with its controller and its estimator. With `bag` the run is recorded.

via launch joint device:=cubic_demo bag:=joint
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, simulation, string


def generate_launch_description() -> LaunchDescription:
    file, device = LaunchConfiguration("parameters"), string("device")
    simulated = {"device": device, "mode": string("mode"), "effects": string("effects")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", default_value="cubic_demo", description="device name or path to its YAML"),
            DeclareLaunchArgument("effects", default_value="", description="effects file for the simulator"),
            *simulation("joint.yaml"),
            node("via_sim", "simulator", file, simulated),
            node("via_controllers", "excitation", file, {"device": device}),
            node("via_estimators", "estimator", file, {"device": device}),
        ]
    )
