"""Node `modal_limit_cycle`: an arm swings on one of its modes, with the amplitude asked for.

ros2 run via_controllers modal_limit_cycle --ros-args -p arm:=reference_4dof -p mode:=1

Topics and lifecycle: see `controller`. It tells H, V, the push s, the modal coordinates z and the modes' frequencies.
Activated, the arm begins to swing by itself, and does so again when it is held and let go; who holds it still bears no
more than the springs do at the turning points of the cycle. With `start` 0 it waits at rest for a push. Deactivate it
to stop it. The default `level` suits the soft modes of reference_4dof: where motors cannot follow, as with modes
3 and 4, they go from limit to limit and no cycle comes of it; begin with a tenth of the level or less.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_ros import spin

from via_controllers.modal_limit_cycle import ModalLimitCycle
from via_controllers.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equipment import ArmParameters, Equipment, equipped
from via_controllers.self_start import START


@dataclass(frozen=True)
class ModalLimitCycleParameters(ArmParameters):
    """Parameters of the node."""

    equilibrium: tuple[float, ...] = field(
        default=(0.2, 0.4, 0.3, 1.2), metadata={"description": "q_d, link angles about which it swings [rad]"}
    )
    stiffness: tuple[float, ...] = field(
        default=(), metadata={"description": "K_d, diagonal [N m/rad]; empty: that of the springs at rest"}
    )
    mode: int = field(default=1, metadata={"description": "mode that swings, 1 the softest", "range": (1, 64)})
    damping_ratio: float = field(
        default=0.7, metadata={"description": "xi of the other modes", "unit": "-", "range": (1e-3, 10.0)}
    )
    gain: float = field(
        default=3.0, metadata={"description": "k_V, how fast H gets there", "unit": "s/(kg m^2)", "range": (1e-6, 1e6)}
    )
    level: float = field(
        default=0.02,
        metadata={"description": "H_d, half the squared amplitude of z", "unit": "kg m^2", "range": (1e-9, 1e3)},
    )
    start: float = field(
        default=START,
        metadata={
            "description": "how far the rest position is moved for a start, of the amplitude; 0: waits for a push",
            "unit": "-",
            "range": (0.0, 1.0),
        },
    )
    bandwidth: float = field(
        default=100.0,
        metadata={"description": "omega_tau of the springs' torques", "unit": "rad/s", "range": (1.0, 1e4)},
    )


def equipment_of(parameters: ModalLimitCycleParameters) -> Equipment:
    """The arm and the law of the node; raises ParameterError or DeviceError."""
    p, arm = parameters, load_vsa_arm(parameters.arm)
    stiffness = np.array(p.stiffness or arm.spring_state(np.zeros(arm.n))[1], dtype=float)
    equilibrium = np.array(p.equilibrium, dtype=float)
    for name, values in (("equilibrium", equilibrium), ("stiffness", stiffness)):
        if values.shape != (arm.n,):
            raise ParameterError(f"parameter {name} must hold {arm.n} numbers, got {values.tolist()}")
    cycle = ModalLimitCycle(arm, equilibrium, np.diag(stiffness), p.mode - 1, p.damping_ratio, p.gain, p.level, p.start)
    return equipped(arm, VsaModalLimitCycle(cycle, p.bandwidth))


class ModalLimitCycleNode(ControllerNode):
    """The node of this file."""

    def __init__(self, **options: Any) -> None:
        super().__init__("modal_limit_cycle", ModalLimitCycleParameters, equipment_of, **options)


def main() -> int:
    """Run the node."""
    return spin.run(ModalLimitCycleNode)


if __name__ == "__main__":
    sys.exit(main())
