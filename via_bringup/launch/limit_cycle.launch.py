"""A simulated arm with flexible joints that oscillates along one of its modes. You can push, hold and release it.

With modal_limit_cycle the arm starts to swing on its own once the controller is active, unless the node parameter
`start` is 0. With bang_bang it stays at rest until it is pushed.

ros2 launch via_bringup limit_cycle.launch.py
ros2 launch via_bringup limit_cycle.launch.py law:=bang_bang mode:=lockstep bag:=swing

ros2 service call /arm_simulator/push via_interfaces/srv/Push "{impulse: [0.3, 0.3, 0.1, 0.1]}"
ros2 service call /arm_simulator/hold via_interfaces/srv/Hold "{duration: 1.0}"
ros2 lifecycle set /modal_limit_cycle deactivate
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PythonExpression
from via_bringup.launching import if_equal, node, simulation, string

CONTROLLERS = ("modal_limit_cycle", "bang_bang")
ARGUMENT, DEFAULT = "law", CONTROLLERS[0]  # chooses the controller


def generate_launch_description() -> LaunchDescription:
    file, arm = LaunchConfiguration("parameters"), string("arm")
    defaults = PythonExpression(["'", LaunchConfiguration(ARGUMENT), "' + '.yaml'"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="reference_4dof", description="arm name or path to its YAML"),
            DeclareLaunchArgument(ARGUMENT, default_value=DEFAULT, description=" or ".join(CONTROLLERS)),
            *simulation(defaults, description="parameter file of the nodes; default: CONTROLLER.yaml"),
            node("via_sim", "arm_simulator", file, {"arm": arm, "mode": string("mode")}),
            *(
                node("via_controllers", controller, file, {"arm": arm}, condition=if_equal(ARGUMENT, controller))
                for controller in CONTROLLERS
            ),
        ]
    )
