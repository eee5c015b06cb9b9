"""Node `bang_bang_joint`: a joint swings by motors that switch where its springs' torque does.

ros2 run via_controllers bang_bang_joint --ros-args -p device:=visco_elastic_demo

Topics and lifecycle: see `controller`. It tells tau_z and the switch. At rest the joint stays there: push it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

from via_core.devices import load_device
from via_ros import spin

from via_controllers.bang_bang_joint import JointBangBang
from via_controllers.joint_axes import JointAxes
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import Equipment, StartParameters, joint_equipment


@dataclass(frozen=True)
class BangBangJointParameters(StartParameters):
    """Parameters of the node."""

    device: str = field(default="visco_elastic_demo", metadata={"description": "device name or path to its YAML"})
    equilibrium: float = field(
        default=0.0,
        metadata={"description": "of theta_0, about which it swings", "unit": "rad", "range": (-10.0, 10.0)},
    )
    preset: float = field(
        default=0.0, metadata={"description": "of theta_0, the stiffness preset", "unit": "rad", "range": (-10.0, 10.0)}
    )
    amplitude: float = field(
        default=0.03, metadata={"description": "theta_hat, how far motors switch", "unit": "rad", "range": (0.0, 10.0)}
    )
    threshold: float = field(
        default=0.1, metadata={"description": "epsilon of tau_z", "unit": "N m", "range": (0.0, 1e6)}
    )
    bandwidth: float = field(
        default=60.0, metadata={"description": "omega_m of the motors", "unit": "rad/s", "range": (1.0, 1e4)}
    )
    velocity_bandwidth: float = field(
        default=500.0, metadata={"description": "low pass of motor velocities", "unit": "rad/s", "range": (1e-3, 1e5)}
    )


def equipment_of(parameters: BangBangJointParameters) -> Equipment:
    """The joint and the law of the node; raises ParameterError or DeviceError."""
    p, device = parameters, load_device(parameters.device)
    law = JointBangBang(
        device, p.equilibrium, p.preset, p.amplitude, p.threshold, p.bandwidth, p.velocity_bandwidth
    )  # fmt: skip
    return joint_equipment(JointAxes(device), law)


class BangBangJointNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("bang_bang_joint", BangBangJointParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(BangBangJointNode)


if __name__ == "__main__":
    sys.exit(main())
