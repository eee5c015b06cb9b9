"""One executable per controller, e.g. `ros2 run via_controllers bang_bang --ros-args -p arm:=reference_4dof`.

excitation          moves an antagonistic joint so that estimators can identify it, or plays a file of torques
equilibrium_preset  tracks an equilibrium and a stiffness of a joint: see nodes/equilibrium_preset.py
bang_bang_joint     limit cycle of a joint by switching motors; starts with a push
max_velocity        accelerates the link of a flexible joint to its largest velocity; reactivate it to repeat
commanded_torque    applies motor torques that ros2_control or another program commands: see nodes/commanded_torque.py
modal_limit_cycle   limit cycle of an arm on one of its modes; with `start` 0 it waits for a push; with `adapt` it
                    corrects its model by estimators: see nodes/adaptive_limit_cycle.py
bang_bang           limit cycle of an arm by switching motors, adapts to the mode; starts with a push
hopping             bang_bang on the hopper

Topics and lifecycle: nodes/controller.py. Parameters: arm_methods.py and joint_methods.py. setup.py defines the
executables as `<name> = via_controllers.nodes.single:<name>` for every name in CONTROLLERS.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from via_ros.spin import run

from via_controllers.methods import CONTROLLERS
from via_controllers.nodes.adaptive_limit_cycle import AdaptiveLimitCycleNode
from via_controllers.nodes.commanded_torque import CommandedTorqueNode
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equilibrium_preset import EquilibriumPresetNode

# How to make the node of each controller.
NODES: dict[str, Callable[..., ControllerNode]] = {
    **{name: partial(ControllerNode, name) for name in CONTROLLERS},
    "commanded_torque": CommandedTorqueNode,
    "equilibrium_preset": EquilibriumPresetNode,
    "modal_limit_cycle": AdaptiveLimitCycleNode,
}


def __getattr__(name: str) -> Callable[[], int]:
    if name not in NODES:
        raise AttributeError(f"no controller '{name}'; available: {', '.join(NODES)}")
    return partial(run, NODES[name])
