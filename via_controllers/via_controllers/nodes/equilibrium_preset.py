"""Node `equilibrium_preset`: a joint of variable stiffness stands at an angle and is as stiff as told.

ros2 run via_controllers equilibrium_preset --ros-args -p device:=qbmove_a -p stiffness:=6.0
ros2 topic pub -1 /qbmove_a/reference via_interfaces/msg/JointReference "{equilibrium: 0.2, stiffness: 8.0}"

subscribes  /<device>/reference  via_interfaces/JointReference, what is wanted from then on
            /<device>/stiffness  via_interfaces/StiffnessEstimate, with parameter `feedback`

The rest of topics and the lifecycle: see `controller`. It tells the reference, whether it is reached, and the factor by
which the spring laws were found to be wrong; that factor is kept while the node lives in one configuration. A reference
that the joint cannot reach is refused, and said. An estimator learns only from motion: move the reference.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Any

from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.status import Status
from via_core.wire import seconds
from via_interfaces.msg import JointReference, StiffnessEstimate
from via_ros import qos, spin
from via_ros.conversions import nanoseconds

from via_controllers.equilibrium_preset import EquilibriumPreset, EquilibriumPresetState
from via_controllers.joint_axes import JointAxes
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import Equipment, Input, StartParameters, joint_equipment


@dataclass(frozen=True)
class EquilibriumPresetParameters(StartParameters):
    """Parameters of the node."""

    device: str = field(default="qbmove_a", metadata={"description": "device name or path to its YAML"})
    equilibrium: float = field(
        default=0.0, metadata={"description": "angle of the link at the start", "unit": "rad", "range": (-10.0, 10.0)}
    )
    stiffness: float = field(
        default=0.0,
        metadata={"description": "at the start; 0: with the preset half way", "unit": "N m/rad", "range": (0.0, 1e9)},
    )
    feedback: bool = field(default=False, metadata={"description": "correct spring laws by the estimated stiffness"})
    bandwidth: float = field(
        default=60.0, metadata={"description": "w of the motors", "unit": "rad/s", "range": (1.0, 1e4)}
    )
    speed: float = field(
        default=2.0, metadata={"description": "of the motors' references", "unit": "rad/s", "range": (1e-3, 1e3)}
    )
    correction_time: float = field(
        default=1.0, metadata={"description": "T of the correction", "unit": "s", "range": (1e-2, 1e4)}
    )
    trusted_deviation: float = field(
        default=0.1,
        metadata={"description": "S, deviation of an estimate that counts half", "unit": "-", "range": (1e-3, 10.0)},
    )


class EquilibriumPresetNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("equilibrium_preset", EquilibriumPresetParameters, self._equipment_of, **options)

    def _equipment_of(self, parameters: EquilibriumPresetParameters) -> Equipment:
        p, device = parameters, load_device(parameters.device)
        self._law = replace(
            EquilibriumPreset.from_device(device, p.bandwidth),
            speed=p.speed,
            correction_time=p.correction_time,
            trusted_deviation=p.trusted_deviation,
        )
        references = self._law.references
        stiffness = p.stiffness or references.stiffness(p.equilibrium, 0.5 * sum(references.presets))
        # Where the law begins whenever it is asked to: with what is wanted now, and what was learnt of the springs.
        self._wanted = self._law.towards(self._law.init(), p.equilibrium, stiffness)
        self._origin: int | None = None  # [ns] stamp of the first estimate
        inputs = [Input(JointReference, f"/{device.name}/reference", qos.CONTROL, self._refer)]
        if p.feedback:
            inputs.append(Input(StiffnessEstimate, f"/{device.name}/stiffness", qos.SAMPLES, self._estimate))
        return joint_equipment(JointAxes(device), self._law, lambda: self._wanted, inputs=tuple(inputs))

    def _refer(self, message: JointReference) -> None:
        try:
            self._wanted = self._law.towards(self._wanted, message.equilibrium, message.stiffness)
        except ViaError as error:
            self.get_logger().warning(f"reference refused: {error}")
            return
        self.inform(lambda state: _aimed(state, self._wanted))

    def _estimate(self, message: StiffnessEstimate) -> None:
        stamp, status = nanoseconds(message.header.stamp), Status(message.status)
        if self._origin is None:
            self._origin = stamp
        time = seconds(stamp, self._origin)

        def know(state: EquilibriumPresetState) -> EquilibriumPresetState:
            after = self._law.estimated(state, time, status, message.value, message.standard_deviation)
            if after.aimed != state.aimed:
                self._wanted = replace(_aimed(self._wanted, after), factor=after.factor)
            return after

        self.inform(know)


def _aimed(state: EquilibriumPresetState, at: EquilibriumPresetState) -> EquilibriumPresetState:
    """`state` on its way to where `at` is aimed."""
    return replace(
        state, equilibrium=at.equilibrium, stiffness=at.stiffness, target=at.target, aimed=at.aimed, reached=at.reached
    )


def main() -> int:
    """Run the node."""
    return spin.run(EquilibriumPresetNode)


if __name__ == "__main__":
    sys.exit(main())
