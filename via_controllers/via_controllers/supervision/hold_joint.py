"""Holds a joint where it is: springs and dampers on the motors, as `hold_still` for arms.

    tau_i = K_P,i (theta_0,i - theta_i) - K_D,i thd_i - tau_e,i(q_0 - theta_0,i)

q_0 is the link angle at the first sample; theta_0 are the motor angles that balance the link there with the present
preset, or the present angles if there is no balance. K_P,i is the stiffness of spring i at rest: the motors damp a
swinging link through its springs. `bandwidth` sets K_P of a slack spring and of a preset motor, which has no spring.
Source: as `hold_still`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array

from via_controllers.contract import ArmSample, require_positive
from via_controllers.joint_axes import JointAxes
from via_controllers.joints.motor_references import UnreachableError, resting
from via_controllers.supervision.holding import Held, Holding


@dataclass(frozen=True, eq=False)
class HoldJoint(Holding):
    """Holding controller of a joint. Raises ParameterError for a damping or bandwidth that is not positive."""

    axes: JointAxes
    damping: float = 1.0  # K_D over sqrt(K_P (B + M)) [-]; about 1 damps oscillations fastest
    bandwidth: float = 10.0  # [rad/s]: K_P is at least B bandwidth^2

    def __post_init__(self) -> None:
        require_positive(self, "damping", "bandwidth")

    def init(self, sample: ArmSample) -> Held:
        axes, q = self.axes, float(sample.q[0])
        theta = self._resting(q, sample.theta)
        proportional = np.maximum(axes.spring_stiffness(q, theta), axes.motor_inertia * self.bandwidth**2)
        return Held(
            theta=theta,
            torque=-axes.spring_torque(q, theta),
            proportional=proportional,
            derivative=self.damping * np.sqrt(proportional * (axes.motor_inertia + axes.device.link.inertia)),
            limit=axes.torque_limit,
        )

    def _resting(self, q: float, theta: Array) -> Array:
        """theta_0 (m,) [rad]."""
        device = self.axes.device
        preset = {
            "flexible": 0.0,
            "antagonistic": 0.5 * float(theta[0] - theta[-1]),
            "serial": float(theta[-1]),
        }[device.arrangement]
        try:
            return device.motor_angles(resting(device, q, preset), preset)
        except UnreachableError:
            return theta
