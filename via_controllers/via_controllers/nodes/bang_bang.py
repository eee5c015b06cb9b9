"""Node `bang_bang`: an arm swings along the mode that its springs' torques show, by motors that switch.

ros2 run via_controllers bang_bang --ros-args -p arm:=reference_4dof -p direction:="[0.0, 1.0, 0.0, 1.0]"

Topics and lifecycle: see `controller`. It tells y, tau_z, the switch and w_1. At rest the arm stays there: push it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_ros import spin

from via_controllers.bang_bang import ModalBangBang
from via_controllers.motor_pd import MotorPd
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import ArmParameters, Equipment, equipped


@dataclass(frozen=True)
class BangBangParameters(ArmParameters):
    """Parameters of the node."""

    motors: tuple[float, ...] = field(
        default=(0.2, 0.5, 0.3, 1.3), metadata={"description": "theta_0, motor angles about which they switch [rad]"}
    )
    direction: tuple[float, ...] = field(
        default=(0.0, 1.0, 0.0, 1.0), metadata={"description": "w_1(0), which joints are to swing together [-]"}
    )
    bandwidth: float = field(
        default=60.0, metadata={"description": "omega_m of the motors", "unit": "rad/s", "range": (1.0, 1e4)}
    )
    amplitude: float = field(
        default=0.03, metadata={"description": "theta_hat, how far motors switch", "unit": "rad", "range": (0.0, 10.0)}
    )
    threshold: float = field(
        default=0.5, metadata={"description": "epsilon of tau_z", "unit": "N m", "range": (0.0, 1e6)}
    )
    adaptation: float = field(
        default=50.0, metadata={"description": "gamma of w_1", "unit": "1/(rad^2 s)", "range": (0.0, 1e6)}
    )


def equipment_of(parameters: BangBangParameters) -> Equipment:
    """The arm and the law of the node; raises ParameterError or DeviceError."""
    p, arm = parameters, load_vsa_arm(parameters.arm)
    motors, direction = np.array(p.motors, dtype=float), np.array(p.direction, dtype=float)
    for name, values in (("motors", motors), ("direction", direction)):
        if values.shape != (arm.n,):
            raise ParameterError(f"parameter {name} must hold {arm.n} numbers, got {values.tolist()}")
    hold = MotorPd(arm, motors, arm.hanging(motors), p.bandwidth)
    return equipped(arm, ModalBangBang(hold, direction, p.amplitude, p.threshold, p.adaptation))


class BangBangNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("bang_bang", BangBangParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(BangBangNode)


if __name__ == "__main__":
    sys.exit(main())
