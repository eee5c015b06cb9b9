"""Motor models of a visco-elastic joint in Section 7: commanded velocity, acceleration or torque.

With phi = theta - q, nu = qd and mu = thetad the link's equations are, with any motor,

    nud = omega^2 phi + 2 D omega (mu - nu),   phid = mu - nu

and the motor        velocity      mu = u,                                                     |u| <= v
                     acceleration  mud = u,                                                    |u| <= a, |mu| <= v
                     torque        B mud = u - M (omega^2 phi + 2 D omega (mu - nu)),          |u| <= tau, |mu| <= v

so that each model is a linear system xd = A x + b u with x = (phi, nu[, mu]), x(0) = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np
from via_controllers.contract import require
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_core.signals import Array

Drive = Literal["velocity", "acceleration", "torque"]


@dataclass(frozen=True)
class DrivenJoint:
    """A joint with its motor. Raises ParameterError for limits or inertias that are not positive."""

    joint: ViscoElasticJoint
    drive: Drive
    limit: float  # of |u| [rad/s, rad/s^2 or N m]
    velocity_limit: float = inf  # v [rad/s] of |mu|; `limit` for the velocity drive
    motor_inertia: float = 1.0  # B [kg m^2], torque drive
    link_inertia: float = 1.0  # M [kg m^2], torque drive

    def __post_init__(self) -> None:
        for name in ("limit", "velocity_limit", "motor_inertia", "link_inertia"):
            require(getattr(self, name) > 0.0, f"{name} must be > 0, got {getattr(self, name)}")

    @property
    def system(self) -> tuple[Array, Array]:
        """A (n, n) and b (n,) of xd = A x + b u; n = 2 with the velocity drive, else 3."""
        omega, D = self.joint.frequency, self.joint.damping_ratio
        spring, damper = omega**2, 2.0 * D * omega
        if self.drive == "velocity":
            return np.array([[0.0, -1.0], [spring, -damper]]), np.array([1.0, damper])
        link = np.array([spring, -damper, damper])
        if self.drive == "acceleration":
            return np.array([[0.0, -1.0, 1.0], link, [0.0, 0.0, 0.0]]), np.array([0.0, 0.0, 1.0])
        motor = -self.link_inertia / self.motor_inertia * link
        return np.array([[0.0, -1.0, 1.0], link, motor]), np.array([0.0, 0.0, 1.0 / self.motor_inertia])


@dataclass(frozen=True)
class Optimum:
    """The optimal motion found by a numerical method."""

    time: Array  # (N + 1,) [s], nodes; the last is t_f
    control: Array  # (N,) u, constant between nodes
    state: Array  # (N + 1, n), x at the nodes
    velocity: float  # qd(t_f) [rad/s]

    @property
    def motor_velocity(self) -> Array:
        """mu [rad/s] at the nodes (N + 1,); velocity drive: that of the next interval, the last one repeated."""
        if self.state.shape[1] == 2:
            return np.append(self.control, self.control[-1])
        return self.state[:, 2]
