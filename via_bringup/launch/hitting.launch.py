"""The 4-DOF arm swings against a wall under bang-bang control. The controller has no model of the wall.

via launch hitting
via launch hitting mode:=lockstep bag:=hitting

via topic echo /reference_4dof/contact
"""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from via_bringup.launching import node, simulation, string


def generate_launch_description() -> LaunchDescription:
    file = LaunchConfiguration("parameters")
    return LaunchDescription(
        [
            *simulation("hitting.yaml"),
            node("via_sim", "arm_simulator", file, {"mode": string("mode")}),
            node("via_controllers", "bang_bang", file),
        ]
    )
