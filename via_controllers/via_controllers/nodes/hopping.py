"""Node `hopping`: the bang-bang law on the hopper, which finds its own rhythm.

ros2 run via_controllers hopping

Topics and lifecycle: see `controller`; inactive it stands on its springs. It tells what `bang_bang` tells.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from via_core.hopper import JOINTS, Hopper
from via_core.signals import Array
from via_ros import spin

from via_controllers.arm_limits import ArmLimits
from via_controllers.bang_bang import ModalBangBang
from via_controllers.motor_pd import MotorPd
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import Equipment, StartParameters, arm_equipment
from via_controllers.supervision import Supervisor


@dataclass(frozen=True)
class HoppingParameters(StartParameters):
    """Parameters of the node."""

    crouch: float = field(
        default=0.6, metadata={"description": "a_0, thighs from the vertical", "unit": "rad", "range": (0.01, 1.5)}
    )
    bandwidth: float = field(
        default=120.0, metadata={"description": "omega_m of the motors", "unit": "rad/s", "range": (1.0, 1e4)}
    )
    amplitude: float = field(
        default=0.1, metadata={"description": "theta_hat, how far motors switch", "unit": "rad", "range": (0.0, 10.0)}
    )
    threshold: float = field(
        default=1.0, metadata={"description": "epsilon of tau_z", "unit": "N m", "range": (0.0, 1e6)}
    )
    adaptation: float = field(
        default=50.0, metadata={"description": "gamma of w_1", "unit": "1/(rad^2 s)", "range": (0.0, 1e6)}
    )


@dataclass(frozen=True)
class Legs(Hopper):
    """The hopper as limits see it: only its motors' torques have any."""

    @property
    def motor_friction(self) -> Array:
        return np.zeros(self.n)

    @property
    def speed_limit(self) -> Array:
        return np.full(self.n, np.inf)

    @property
    def deflection_limit(self) -> Array:
        return np.full(self.n, np.inf)

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """Springs' torques; nobody asks for accelerations where no spring has a stop."""
        return self.spring_state(q - theta)[0], np.zeros(self.n)


def equipment_of(parameters: HoppingParameters) -> Equipment:
    """The robot and the law of the node; raises ParameterError."""
    p, legs = parameters, Legs()
    motors = legs.crouched(p.crouch)
    hold = MotorPd(legs, motors, legs.standing(p.crouch), p.bandwidth)
    law = ModalBangBang(hold, np.sign(motors), p.amplitude, p.threshold, p.adaptation)
    return arm_equipment("hopper", JOINTS, Supervisor(law, replace(law, amplitude=0.0), ArmLimits(legs)))


class HoppingNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hopping", HoppingParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(HoppingNode)


if __name__ == "__main__":
    sys.exit(main())
