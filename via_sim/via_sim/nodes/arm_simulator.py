"""Node `arm_simulator`: one simulated arm with flexible joints, and walls as obstacles.

ros2 run via_sim arm_simulator --ros-args -p arm:=reference_4dof -p mode:=lockstep

Topics and services: see `robot_simulation`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from via_core.errors import ParameterError
from via_core.parameters import parameter
from via_core.vsa_arms import load_vsa_arm
from via_ros.spin import run

from via_sim.nodes.robot_simulation import RobotParameters, RobotSimulationNode
from via_sim.robots.arm import ArmBody
from via_sim.robots.contacts import Wall

WALL = 6  # numbers per wall: a point on it [m] and its normal


@dataclass(frozen=True)
class ArmSimulatorParameters(RobotParameters):
    """Parameters of `arm_simulator`."""

    arm: str = parameter("reference_4dof", "arm name or path to its YAML")
    posture: tuple[float, ...] = parameter((), "initial link angles, base first [rad]; empty: all zero")
    walls: tuple[float, ...] = parameter((), "six numbers per wall: a point on it [m], its normal; empty: none")
    link_friction: tuple[float, ...] = parameter(
        (), "viscous friction of the links [N m s/rad]; empty: as in the arm file"
    )
    payload: float = parameter(0.0, "point mass at the tip, beyond the arm file", "kg", (0.0, 1e3))
    spring_scale: tuple[float, ...] = parameter((), "spring torques over those of the arm file [-]; empty: 1")


def body_of(parameters: ArmSimulatorParameters) -> ArmBody:
    """The arm described by the parameters; raises ParameterError or DeviceError."""
    arm, numbers = load_vsa_arm(parameters.arm), np.array(parameters.walls, dtype=float)
    if len(numbers) % WALL:
        raise ParameterError(f"parameter walls must hold {WALL} numbers per wall, got {len(numbers)}")
    if parameters.link_friction:
        arm = replace(arm, link_friction=np.array(parameters.link_friction, dtype=float))
    scale = np.array(parameters.spring_scale or [1.0] * arm.n, dtype=float)
    if scale.shape != (arm.n,) or not (np.isfinite(scale).all() and scale.min() > 0.0):
        raise ParameterError(f"parameter spring_scale must hold {arm.n} numbers > 0, got {scale.tolist()}")
    arm = arm.corrected(parameters.payload, scale)
    walls = tuple(Wall(row[:3], row[3:]) for row in numbers.reshape(-1, WALL))
    return ArmBody(arm, np.array(parameters.posture or [0.0] * arm.n, dtype=float), walls)


class ArmSimulatorNode(RobotSimulationNode):
    """Simulator node of an arm."""

    def __init__(self, **options: Any) -> None:
        super().__init__("arm_simulator", ArmSimulatorParameters, body_of, **options)


main = partial(run, ArmSimulatorNode)  # the executable
