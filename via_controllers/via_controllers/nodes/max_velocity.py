"""Node `max_velocity`: the link of a flexible joint as fast as can be at a given time, Section 7's policy.

ros2 run via_controllers max_velocity --ros-args -p device:=visco_elastic_demo -p turns:=3

Topics and lifecycle: see `controller`. It begins with the first sample after it is activated, from wherever the motor
then stands; once more: deactivate and activate it. It tells how long it is to t_f, and the velocities it sees.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Any

from via_core.devices import load_device
from via_ros import spin

from via_controllers.joint_axes import JointAxes
from via_controllers.max_velocity import MaxVelocity, joint_of
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import Equipment, StartParameters, joint_equipment


@dataclass(frozen=True)
class MaxVelocityParameters(StartParameters):
    """Parameters of the node."""

    device: str = field(default="visco_elastic_demo", metadata={"description": "device name or path to its YAML"})
    turns: int = field(default=3, metadata={"description": "half swings before the last stretch", "range": (0, 1000)})
    damping: float = field(
        default=0.0, metadata={"description": "command of the damper meanwhile", "unit": "-", "range": (0.0, 1.0)}
    )
    bandwidth: float = field(
        default=100.0, metadata={"description": "w of the motor's loop", "unit": "rad/s", "range": (1.0, 1e4)}
    )
    speed_share: float = field(
        default=0.9,  # with more the limit would not be kept whatever the law does: velocities are known late
        metadata={"description": "of the motor's speed limit that is used", "unit": "-", "range": (0.01, 0.9)},
    )


def equipment_of(parameters: MaxVelocityParameters) -> Equipment:
    """The joint and the law of the node; raises ParameterError or DeviceError."""
    p, device = parameters, load_device(parameters.device)
    joint = joint_of(device, p.damping)
    horizon = joint.first_turn + p.turns * joint.between_turns
    law = MaxVelocity.from_device(device, horizon, p.damping, p.bandwidth)
    law = replace(law, velocity=p.speed_share * law.velocity)
    # Its optimum is the motor at full speed, to and fro: nothing is kept back to follow links.
    return joint_equipment(JointAxes(device, p.damping), law, drive=p.speed_share)


class MaxVelocityNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("max_velocity", MaxVelocityParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(MaxVelocityNode)


if __name__ == "__main__":
    sys.exit(main())
