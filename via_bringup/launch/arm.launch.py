"""Several simulated joints and one node that estimates all of them with several methods.

via launch arm
via launch arm joints:="shoulder=qbmove_a elbow=qbmove_b" methods:=auto

Every joint has its own simulator and controller, and publishes its joint states as separate messages. Estimates are
published on /<joint>/<method>/stiffness and similar topics. For a real robot use `simulated:=false`, which starts only
the estimator bank.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from via_bringup.launching import network, node, parameter_file
from via_core.devices import load_device

MOTION = {
    "equilibrium_amplitudes": [0.2, 0.1],  # [rad]
    "equilibrium_frequencies": [0.7, 1.9],  # [Hz]
    "preset_mean": 0.4,  # [rad]
    "preset_amplitudes": [0.1],  # [rad]
    "preset_frequencies": [0.3],  # [Hz]
    "fade_in": 0.5,  # [s]; keeps the motors below half their speed limit
}


def nodes(context: LaunchContext) -> list[Node]:
    """The estimator bank, and for each joint a simulator and a controller."""
    file = LaunchConfiguration("parameters").perform(context)
    joints = LaunchConfiguration("joints").perform(context).split()
    methods = LaunchConfiguration("methods").perform(context).split()
    simulated = IfCondition(LaunchConfiguration("simulated"))
    started = [node("via_estimators", "estimator_bank", file, {"devices": joints, "methods": methods})]
    for seed, joint in enumerate(joints):
        name = load_device(joint).name
        # Simulated time starts when the bank and all controllers have subscribed.
        body = {"device": joint, "seed": seed, "truth": True, "listeners": 1 + len(joints)}
        started += [
            node("via_sim", "simulator", body, name=f"{name}_simulator", condition=simulated),
            node(
                "via_controllers", "excitation", MOTION, {"device": joint}, name=f"{name}_excitation",
                condition=simulated,
            ),
        ]  # fmt: skip
    return started


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            *network(),
            DeclareLaunchArgument(
                "joints",
                default_value="j1=qbmove_a j2=qbmove_a j3=qbmove_a j4=qbmove_a",
                description="joints, separated by spaces: device, path to its YAML, or NAME=either of these",
            ),
            DeclareLaunchArgument("methods", default_value="all", description="auto, all or names of estimators"),
            DeclareLaunchArgument("simulated", default_value="true", description="false: for a real robot"),
            parameter_file("arm.yaml", "parameter file of the estimator bank"),
            OpaqueFunction(function=nodes),
        ]
    )
