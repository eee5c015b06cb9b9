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
from numba import njit
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, Torques, limited, require_positive


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
        require_positive(self, "bandwidth")

    def observed(self, sample: ArmSample) -> FlexibilityState:
        """tau_e, measured or by the springs' laws, and the qdd that follows without a load on the links."""
        by_law, stiffness, slope = self.arm.spring_state(sample.q - sample.theta)
        torque, rate = _measured(by_law, sample.spring_torque, stiffness, sample.q_velocity - sample.theta_velocity)
        acceleration = self.arm.link_acceleration(sample.q, sample.q_velocity, -torque)
        return FlexibilityState(torque, rate, stiffness, slope, acceleration)

    def wanted(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Array:
        """Motor torques (n,) [N m] of (107), not yet limited."""
        arm = self.arm
        return np.asarray(
            _wanted(
                reference.torque, reference.rate, reference.second, seen.torque, seen.rate, seen.stiffness,
                seen.stiffness_slope, seen.acceleration, sample.q_velocity, sample.theta_velocity,
                arm.motor_inertia, arm.motor_friction, self.bandwidth,
            )
        )  # fmt: skip

    def torques(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Torques:
        """Motor torques of (107) within the limits; a motor at its speed limit is driven no further."""
        torque = self.wanted(sample, seen, reference)
        too_fast = _slowed(torque, sample.theta_velocity, self.arm.speed_limit)
        within = limited(torque, self.arm.torque_limit)
        return Torques(within.torque, within.saturated or too_fast)


@njit(cache=True, error_model="numpy")
def _measured(by_law: Array, measured: Array, stiffness: Array, deflection_rate: Array) -> tuple[Array, Array]:
    """tau_e (n,), measured where it is, and its rate (n,)."""
    return np.where(np.isfinite(measured), measured, by_law), stiffness * deflection_rate


@njit(cache=True, error_model="numpy")
def _wanted(
    torque: Array, rate: Array, second: Array, tau_e: Array, tau_e_rate: Array, stiffness: Array, slope: Array,
    acceleration: Array, velocity: Array, motor_velocity: Array, inertia: Array, friction: Array, omega: float,
) -> Array:  # fmt: skip
    out = np.empty(torque.size)
    for i in range(torque.size):
        asked = second[i] + 2.0 * omega * (rate[i] - tau_e_rate[i]) + omega**2 * (torque[i] - tau_e[i])
        bending = slope[i] * (velocity[i] - motor_velocity[i]) ** 2
        motor = acceleration[i] - (asked - bending) / stiffness[i]
        out[i] = inertia[i] * motor + friction[i] * motor_velocity[i] - torque[i]
    return out


@njit(cache=True, error_model="numpy")
def _slowed(torque: Array, speed: Array, limit: Array) -> bool:
    """Takes the torques away that drive motors beyond their speed; whether there were any."""
    found = False
    for i in range(torque.size):
        if abs(speed[i]) >= limit[i] and torque[i] * speed[i] > 0.0:
            torque[i], found = 0.0, True
    return found
