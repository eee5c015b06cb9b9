"""PD position control of the motors of an arm: eq. (120) with the static torque that the printed form lacks.

    tau = tau_0 - K_D thd - K_P (theta - theta_d),   tau_0 = -tau_e(q_0 - theta_0)

q_0 are the link angles at rest with the motors at theta_0. Without tau_0 the spring load, -tau_e = g(q_0), shifts the
motors from their reference by K_P^-1 tau_e. The gains give a motor alone the frequency omega_m and damping ratio one:

    K_P = B omega_m^2,   K_D = 2 B omega_m

Source: the document's Section 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from via_core.hopper import Hopper
from via_core.signals import Array, locked
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, Torques, limited, require, require_positive


@dataclass(frozen=True, eq=False)
class MotorPd:
    """The PD control. Raises ParameterError for a bandwidth <= 0 or angles that are not (n,) and finite."""

    drives: VsaArm | Hopper
    motors: Array  # theta_0 (n,) [rad]
    equilibrium: Array  # q_0 (n,) [rad]
    bandwidth: float  # omega_m [rad/s]

    def __post_init__(self) -> None:
        for name in ("motors", "equilibrium"):
            values = locked(getattr(self, name), name)
            good = values.shape == (self.drives.n,) and bool(np.isfinite(values).all())
            require(good, f"{name} must be ({self.drives.n},) and finite, got {values}")
            object.__setattr__(self, name, values)
        require_positive(self, "bandwidth")

    @cached_property
    def static_torque(self) -> Array:
        """tau_0 (n,) [N m], which balances the spring load at rest."""
        tau_e, _, _ = self.drives.spring_state(self.equilibrium - self.motors)
        return -tau_e

    def torques(self, sample: ArmSample, motors: Array) -> Torques:
        """Motor torques within the limits that drive the motors to theta_d = `motors` (n,) [rad]."""
        B, omega = self.drives.motor_inertia, self.bandwidth
        feedback = omega * (sample.theta - motors) + 2.0 * sample.theta_velocity
        return limited(self.static_torque - omega * B * feedback, self.drives.torque_limit)
