"""A simulated arm with flexible joints that oscillates along one of its modes. You can push, hold and release it.

With modal_limit_cycle the arm starts to swing on its own once the controller is active, unless the node parameter
`start` is 0. With bang_bang it stays at rest until it is pushed.

With `adapt:=true` modal_limit_cycle corrects its model while it runs: node `payload` estimates the mass at the tip,
node `estimator` the stiffness of each joint. `payload` and `softer` change the simulated arm, but not the model.

via launch limit_cycle
via launch limit_cycle controller:=bang_bang mode:=lockstep bag:=swing
via launch limit_cycle adapt:=true payload:=0.44 softer:=0.1

via service call /arm_simulator/push via_interfaces/srv/Push "{impulse: [0.3, 0.3, 0.1, 0.1]}"
via service call /arm_simulator/hold via_interfaces/srv/Hold "{duration: 1.0}"
via lifecycle set /modal_limit_cycle deactivate
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from via_bringup.launching import flag, if_equal, node, simulation, string
from via_core.vsa_arms import load_vsa_arm

CONTROLLERS = ("modal_limit_cycle", "bang_bang")
ARGUMENT, DEFAULT = "controller", CONTROLLERS[0]  # chooses the controller


def simulator_and_estimators(context: LaunchContext) -> list[Node]:
    """The simulator, and with `adapt` the estimators, which it waits for."""

    def given(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    name, adapts = given("arm"), given("adapt") == "true" and given(ARGUMENT) == DEFAULT
    arm = load_vsa_arm(name)
    body = {
        "arm": name, "mode": given("mode"), "payload": float(given("payload")),
        "spring_scale": [1.0 - float(given("softer"))] * arm.n, "listeners": 3 if adapts else 1,
    }  # fmt: skip
    devices = [f"{name}:{joint}" for joint in arm.joints]
    estimators = [
        node("via_estimators", "payload", {"arm": name}),
        node("via_estimators", "estimator", {"devices": devices}),
    ]
    file = LaunchConfiguration("parameters")
    return [node("via_sim", "arm_simulator", file, body), *(estimators if adapts else [])]


def generate_launch_description() -> LaunchDescription:
    file, arm = LaunchConfiguration("parameters"), string("arm")
    defaults = PythonExpression(["'", LaunchConfiguration(ARGUMENT), "' + '.yaml'"])
    own = {DEFAULT: {"adapt": flag("adapt")}}
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="reference_4dof", description="arm name or path to its YAML"),
            DeclareLaunchArgument(ARGUMENT, default_value=DEFAULT, description=" or ".join(CONTROLLERS)),
            DeclareLaunchArgument("adapt", default_value="false", description="true: estimators correct the model"),
            DeclareLaunchArgument("payload", default_value="0.0", description="mass at the simulated tip [kg]"),
            DeclareLaunchArgument(
                "softer", default_value="0.0", description="share by which the simulated springs are softer than filed"
            ),
            *simulation(defaults, description="parameter file of the nodes; default: CONTROLLER.yaml"),
            OpaqueFunction(function=simulator_and_estimators),
            *(
                node(
                    "via_controllers", controller, file, {"arm": arm, **own.get(controller, {})},
                    condition=if_equal(ARGUMENT, controller),
                )
                for controller in CONTROLLERS
            ),
        ]
    )  # fmt: skip
