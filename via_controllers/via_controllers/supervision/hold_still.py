"""Holds an arm of flexible joints where it is: springs and dampers on the motors, static torques from the model.

    tau = g(q_0) + K_P (theta_0 - theta) - K_D thd,   theta_0 = q_0 + spring deflection under g(q_0)

q_0 are the link angles at the first sample. Only motors are fed back: they damp swinging links through the springs, so
that K_P is not larger than the spring stiffness. The control is passive and stable even with a wrong model.
Source: Tomei, A simple PD controller for robots with elastic joints, IEEE Trans. Automatic Control 36 (1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, require_positive
from via_controllers.supervision.holding import Held, Holding

REACH = 0.9  # largest static deflection over the spring's stop; a larger gravity load is not compensated


@dataclass(frozen=True, eq=False)
class HoldStill(Holding):
    """Holding controller of an arm. Raises ParameterError for gains that are not positive."""

    arm: VsaArm
    stiffness: float = 1.0  # K_P over the spring stiffness at theta_0 [-]
    damping: float = 2.0  # K_D over sqrt(stiffness inertia) of motor and spring [-]; 2 damps oscillations fastest

    def __post_init__(self) -> None:
        require_positive(self, "stiffness", "damping")

    def init(self, sample: ArmSample) -> Held:
        arm = self.arm
        most = arm.spring_strength(REACH)
        torque = np.clip(arm.gravity(sample.q), -most, most)
        phi = arm.deflection(-torque)
        _, stiffness, _ = arm.spring_state(phi)
        return Held(
            theta=sample.q - phi,
            torque=torque,
            proportional=self.stiffness * stiffness,
            derivative=self.damping * np.sqrt(stiffness * arm.motor_inertia),
            limit=arm.torque_limit,
        )
