"""Motors of an arm held at a reference by a PD law: eq. (120) with the static torque that the printed form lacks.

    tau = tau_0 - K_D thd - K_P (theta - theta_d),   tau_0 = -tau_e(q_0 - theta_0)

q_0 is where the links rest with the motors at theta_0. Without tau_0 the springs' load, -tau_e = g(q_0), pulls the
motors off their reference by K_P^-1 tau_e. The gains are those of a motor alone, of frequency omega_m and damping
ratio one:

    K_P = B omega_m^2,   K_D = 2 B omega_m

Source: the document's Section 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from via_core.signals import Array, locked

from via_controllers.contract import ArmSample, Torques, limited, require, require_positive


class Drives(Protocol):
    """What these laws must know of n flexible joints; `via_core.vsa_arms.VsaArm` knows it."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def motor_inertia(self) -> Array:
        """B (n,) [kg m^2]."""

    @property
    def torque_limit(self) -> Array:
        """(n,) [N m] of the motors."""

    def spring_state(self, deflection: Array) -> tuple[Array, Array, Array]:
        """tau_e [N m], sigma [N m/rad] and its slope [N m/rad^2] at `deflection` (n,) [rad], each (n,)."""


@dataclass(frozen=True, eq=False)
class MotorPd:
    """The law of this file. Raises ParameterError for a bandwidth <= 0 or angles that are not (n,) and finite."""

    drives: Drives
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
        tau_e, _, _ = self.drives.spring_state(self.equilibrium - self.motors)
        object.__setattr__(self, "_static", -tau_e)

    @property
    def static_torque(self) -> Array:
        """tau_0 (n,) [N m]: what holds the springs' load at rest."""
        return self._static  # type: ignore[attr-defined, no-any-return]

    def torques(self, sample: ArmSample, motors: Array) -> Torques:
        """Motor torques within the limits that bring the motors to theta_d `motors` (n,) [rad]."""
        B, omega = self.drives.motor_inertia, self.bandwidth
        pull = omega * (sample.theta - motors) + 2.0 * sample.theta_velocity
        return limited(self.static_torque - omega * B * pull, self.drives.torque_limit)
