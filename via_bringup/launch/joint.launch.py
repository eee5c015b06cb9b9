"""A simulated joint with its controller, its estimator and, if asked, a recorder.

ros2 launch via_bringup joint.launch.py device:=cubic_demo bag:=joint
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, simulation, text


def generate_launch_description() -> LaunchDescription:
    file, device = LaunchConfiguration("parameters"), text("device")
    simulated = {"device": device, "mode": text("mode"), "effects": text("effects")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("device", default_value="cubic_demo", description="device or path to its YAML"),
            DeclareLaunchArgument("effects", default_value="", description="effects file the simulator adds"),
            *simulation("joint.yaml"),
            node("via_sim", "simulator", file, simulated),
            node("via_controllers", "excitation", file, {"device": device}),
            node("via_estimators", "estimator", file, {"device": device}),
        ]
    )
