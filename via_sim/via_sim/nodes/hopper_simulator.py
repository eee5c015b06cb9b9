"""Node `hopper_simulator`: the planar hopper, dropped from a small height onto flat ground.

ros2 run via_sim hopper_simulator --ros-args -p mode:=lockstep -p payload:=6.0

Topics and services: see `robot_simulation`; /hopper/base is the pose of the trunk, /hopper/contact the ground force.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

from via_core.hopper import Hopper
from via_ros.spin import run

from via_sim.nodes.robot_simulation import RobotParameters, RobotSimulationNode
from via_sim.robots.hopper_body import HopperBody


@dataclass(frozen=True)
class HopperSimulatorParameters(RobotParameters):
    """Parameters of `hopper_simulator`."""

    payload: float = field(default=0.0, metadata={"description": "on the trunk", "unit": "kg", "range": (0.0, 1e3)})
    crouch: float = field(
        default=0.6,
        metadata={
            "description": "initial angle a_0 of the thighs",
            "unit": "rad",
            "range": (0.01, 1.5),
        },
    )
    drop: float = field(default=0.03, metadata={"description": "initial height", "unit": "m", "range": (0.0, 1.0)})


def body_of(parameters: HopperSimulatorParameters) -> HopperBody:
    """The hopper described by the parameters."""
    return HopperBody(Hopper(payload=parameters.payload), parameters.crouch, parameters.drop)


class HopperSimulatorNode(RobotSimulationNode):
    """Simulator node of the hopper."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hopper_simulator", HopperSimulatorParameters, body_of, **options)


def main() -> int:
    """Run the node."""
    return run(HopperSimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
