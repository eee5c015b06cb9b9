"""A simulated arm of flexible joints that swings on one of its modes; push it, hold it, let it go.

With modal_limit_cycle the arm begins to swing by itself as soon as the law is active, unless its `start` is 0; with
bang_bang it stays at rest until it is pushed.

ros2 launch via_bringup limit_cycle.launch.py
ros2 launch via_bringup limit_cycle.launch.py law:=bang_bang mode:=lockstep bag:=swing

ros2 service call /arm_simulator/push via_interfaces/srv/Push "{impulse: [0.3, 0.3, 0.1, 0.1]}"
ros2 service call /arm_simulator/hold via_interfaces/srv/Hold "{duration: 1.0}"
ros2 lifecycle set /modal_limit_cycle deactivate
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PythonExpression
from via_bringup.launching import node, simulation, text, when


def generate_launch_description() -> LaunchDescription:
    file, arm = LaunchConfiguration("parameters"), text("arm")
    defaults = PythonExpression(["'", LaunchConfiguration("law"), "' + '.yaml'"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="reference_4dof", description="arm or path to its YAML"),
            DeclareLaunchArgument("law", default_value="modal_limit_cycle", description="modal_limit_cycle, bang_bang"),
            *simulation(defaults, description="parameter file of the nodes; else that of the law"),
            node("via_sim", "arm_simulator", file, {"arm": arm, "mode": text("mode")}),
            *(
                node("via_controllers", law, file, {"arm": arm}, condition=when("law", law))
                for law in ("modal_limit_cycle", "bang_bang")
            ),
        ]
    )
