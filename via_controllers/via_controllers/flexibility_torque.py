"""Torques of flexible joints made to follow a reference: eqs. (105)-(108), with tau_e of q - theta as everywhere here.

With phi = q - theta and sigma' = dsigma/dphi

    tau_e' = sigma phid,   tau_e'' = sigma (qdd - thdd) + sigma' phid^2,   B thdd + D thd - tau_e = tau

so that the motor torque, e = tau_ed - tau_e,

    tau = -tau_ed + D thd + B [qdd - (tau_ed'' + D_tau e' + K_tau e - sigma' phid^2) / sigma]            (107)

leaves, at constant preset,

    e'' + D_tau e' + (K_tau + sigma / B) e = 0                                                           (108)

The acceleration of the links comes from their own equation, (9): no sensor of it is needed. Where a motor is at its
torque or speed limit, (108) does not hold.
Source: the document's Section 6.1; there psi(theta - q) = -tau_e.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, Torques, limited, require


@dataclass(frozen=True)
class TorqueReference:
    """tau_ed (n,) [N m] and its first two derivatives by time."""

    torque: Array
    rate: Array
    second: Array


@dataclass(frozen=True)
class FlexibilityState:
    """What springs and links do at one instant, (n,) each."""

    torque: Array  # tau_e [N m]
    rate: Array  # [N m/s]
    stiffness: Array  # sigma [N m/rad]
    stiffness_slope: Array  # [N m/rad^2]
    acceleration: Array  # qdd [rad/s^2]


@dataclass(frozen=True, eq=False)
class FlexibilityTorque:
    """The law of this file: K_tau = bandwidth^2, D_tau = 2 bandwidth. Raises ParameterError for a bandwidth <= 0."""

    arm: VsaArm
    bandwidth: float  # omega_tau [rad/s]

    def __post_init__(self) -> None:
        good = np.isfinite(self.bandwidth) and self.bandwidth > 0.0
        require(good, f"bandwidth must be > 0 rad/s, got {self.bandwidth}")

    def observed(self, sample: ArmSample) -> FlexibilityState:
        """tau_e, measured or by the springs' laws, and the qdd that follows without a load on the links."""
        by_law, stiffness, slope = self.arm.spring_state(sample.q - sample.theta)
        torque = np.where(np.isfinite(sample.spring_torque), sample.spring_torque, by_law)
        rate = stiffness * (sample.q_velocity - sample.theta_velocity)
        acceleration = self.arm.link_acceleration(sample.q, sample.q_velocity, -torque)
        return FlexibilityState(torque, rate, stiffness, slope, acceleration)

    def wanted(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Array:
        """Motor torques (n,) [N m] of (107), not yet limited."""
        arm, omega = self.arm, self.bandwidth
        deflection_rate = sample.q_velocity - sample.theta_velocity
        error, error_rate = reference.torque - seen.torque, reference.rate - seen.rate
        asked = reference.second + 2.0 * omega * error_rate + omega**2 * error
        motor = seen.acceleration - (asked - seen.stiffness_slope * deflection_rate**2) / seen.stiffness
        return arm.motor_inertia * motor + arm.motor_friction * sample.theta_velocity - reference.torque

    def torques(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Torques:
        """Motor torques of (107) within the limits; a motor at its speed limit is driven no further."""
        torque, speed = self.wanted(sample, seen, reference), sample.theta_velocity
        too_fast = (np.abs(speed) >= self.arm.speed_limit) & (torque * speed > 0.0)
        within = limited(np.where(too_fast, 0.0, torque), self.arm.torque_limit)
        return Torques(within.torque, within.saturated or bool(too_fast.any()))
