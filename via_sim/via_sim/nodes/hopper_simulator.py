"""Node `hopper_simulator`: the planar hopper, dropped from a small height onto flat ground.

ros2 run via_sim hopper_simulator --ros-args -p mode:=lockstep -p payload:=6.0

Topics and services: see `robot_simulation`; /hopper/base is the pose of the trunk, /hopper/contact the ground force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from via_core.hopper import Hopper
from via_core.parameters import parameter
from via_ros.spin import run

from via_sim.nodes.robot_simulation import RobotParameters, RobotSimulationNode
from via_sim.robots.hopper import HopperPlant


@dataclass(frozen=True)
class HopperSimulatorParameters(RobotParameters):
    """Parameters of `hopper_simulator`."""

    payload: float = parameter(0.0, "on the trunk", "kg", (0.0, 1e3))
    crouch: float = parameter(HopperPlant.crouch, "initial angle a_0 of the thighs", "rad", (0.01, 1.5))
    drop: float = parameter(HopperPlant.drop, "initial height", "m", (0.0, 1.0))


def body_of(parameters: HopperSimulatorParameters) -> HopperPlant:
    """The hopper described by the parameters."""
    return HopperPlant(Hopper(payload=parameters.payload), parameters.crouch, parameters.drop)


class HopperSimulatorNode(RobotSimulationNode):
    """Simulator node of the hopper."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hopper_simulator", HopperSimulatorParameters, body_of, **options)


main = partial(run, HopperSimulatorNode)  # the executable
