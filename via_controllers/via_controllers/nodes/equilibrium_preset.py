"""Node `equilibrium_preset`: tracks a commanded equilibrium and stiffness of a joint of variable stiffness.

ros2 run via_controllers equilibrium_preset --ros-args -p device:=qbmove_a -p stiffness:=6.0
via topic pub -1 /qbmove_a/reference via_interfaces/msg/JointReference "{equilibrium: 0.2, stiffness: 8.0}"

subscribes  /<device>/reference  via_interfaces/JointReference, the new references
            /<device>/stiffness  via_interfaces/StiffnessEstimate, with parameter `feedback`

Other topics and the lifecycle: see `controller`. /<device>/control reports the references, whether they are reached,
and the correction factor of the spring laws. The factor outlasts a deactivation; without an estimate with status OK it
returns to 1 within `fallback_time`. A reference out of reach is refused and reported. The estimator needs motion to
converge: move the reference.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from via_core.status import Status
from via_interfaces.msg import JointReference, StiffnessEstimate
from via_ros import qos

from via_controllers.joint_axes import JointAxes
from via_controllers.joint_methods import EquilibriumPresetParameters
from via_controllers.joints.equilibrium_preset import EquilibriumPresetState
from via_controllers.nodes.controller import ControllerNode, Input
from via_controllers.robot import ControlledJoint
from via_controllers.supervision.joint_supervision import JointSupervisor


class EquilibriumPresetNode(ControllerNode):
    """The controller node with inputs for references and stiffness estimates."""

    def __init__(self, **options: Any) -> None:
        super().__init__("equilibrium_preset", self._connected, **options)

    def _connected(self, parameters: EquilibriumPresetParameters) -> tuple[ControlledJoint, tuple[Input, ...]]:
        self._controller = parameters.controller()
        # The controller restarts from here: with the latest references and the latest correction of the spring laws.
        self._start = parameters.initial(self._controller)
        device = self._controller.references.device
        inputs: list[Input] = [(JointReference, f"{device.name}/reference", self._refer, qos.CONTROL)]
        if parameters.feedback:
            inputs.append((StiffnessEstimate, f"{device.name}/stiffness", self._estimate, qos.SAMPLES))
        axes = JointAxes(device)
        return ControlledJoint(axes, JointSupervisor.of(self._controller, axes, lambda: self._start)), tuple(inputs)

    def _refer(self, message: JointReference) -> None:
        given = (message.equilibrium, message.stiffness)
        # Raises if out of reach, and the gate reports it.
        self._start = self._controller.with_reference(self._start, *given)
        self.update(lambda state: self._controller.with_reference(state, *given))

    def _estimate(self, message: StiffnessEstimate) -> None:
        time, status = self.time_of(message.header.stamp), Status(message.status)

        def estimated(state: EquilibriumPresetState) -> EquilibriumPresetState:
            after = self._controller.with_estimate(state, time, status, message.value, message.standard_deviation)
            self._start = replace(
                self._start, target=after.target, target_factor=after.target_factor, reached=after.reached,
                correction=after.correction,
            )  # fmt: skip
            return after

        self.update(estimated)
