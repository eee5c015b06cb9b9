"""Torque control of flexible joints: eqs. (105)-(108), with tau_e of q - theta.

With phi = q - theta and sigma' = dsigma/dphi

    tau_e' = sigma phid,   tau_e'' = sigma (qdd - thdd) + sigma' phid^2,   B thdd + D thd - tau_e = tau

so that the motor torque, e = tau_ed - tau_e,

    tau = -tau_ed + D thd + B [qdd - (tau_ed'' + D_tau e' + K_tau e - sigma' phid^2) / sigma]            (107)

results, at constant preset, in

    e'' + D_tau e' + (K_tau + sigma / B) e = 0                                                           (108)

The acceleration of the links follows from their equation of motion, (9), without a sensor. (108) does not hold while a
motor is at its torque or speed limit.
Source: the document's Section 6.1; there psi(theta - q) = -tau_e.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, Torques, limited, require_positive


class TorqueReference(NamedTuple):
    """tau_ed (n,) [N m] and its first two time derivatives."""

    torque: Array
    rate: Array
    second: Array


class FlexibilityState(NamedTuple):
    """State of springs and links at one time, (n,) each."""

    torque: Array  # tau_e [N m]
    rate: Array  # [N m/s]
    stiffness: Array  # sigma [N m/rad]
    stiffness_slope: Array  # [N m/rad^2]
    acceleration: Array  # qdd [rad/s^2]


class _Motors(NamedTuple):
    """Constants of the motors, (n,) each."""

    inertia: Array  # B [kg m^2]
    friction: Array  # D [N m s/rad]


@dataclass(frozen=True, eq=False)
class FlexibilityTorque:
    """Torque control, K_tau = bandwidth^2, D_tau = 2 bandwidth. Raises ParameterError for a bandwidth <= 0."""

    arm: VsaArm
    bandwidth: float  # omega_tau [rad/s]

    def __post_init__(self) -> None:
        require_positive(self, "bandwidth")

    def observed(self, sample: ArmSample) -> FlexibilityState:
        """tau_e, measured or from the spring laws, and the resulting qdd without a load on the links."""
        nominal, stiffness, slope = self.arm.spring_state(sample.q - sample.theta)
        torque, rate = _measured(nominal, sample.spring_torque, stiffness, sample.q_velocity - sample.theta_velocity)
        acceleration = self.arm.link_acceleration(sample.q, sample.q_velocity, -torque)
        return FlexibilityState(torque, rate, stiffness, slope, acceleration)

    def unlimited(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Array:
        """Motor torques (n,) [N m] of (107)."""
        motors = _Motors(self.arm.motor_inertia, self.arm.motor_friction)
        return np.asarray(_unlimited(reference, seen, motors, sample.q_velocity, sample.theta_velocity, self.bandwidth))

    def torques(self, sample: ArmSample, seen: FlexibilityState, reference: TorqueReference) -> Torques:
        """Motor torques of (107) within the limits; a motor at its speed limit is not accelerated further."""
        torque = self.unlimited(sample, seen, reference)
        too_fast = _slow_down(torque, sample.theta_velocity, self.arm.speed_limit)
        within = limited(torque, self.arm.torque_limit)
        return Torques(within.torque, within.saturated or too_fast)


@njit(cache=True, error_model="numpy")
def _measured(nominal: Array, measured: Array, stiffness: Array, deflection_rate: Array) -> tuple[Array, Array]:
    """tau_e (n,), measured or else nominal, and its rate (n,)."""
    return np.where(np.isfinite(measured), measured, nominal), stiffness * deflection_rate


@njit(cache=True, error_model="numpy")
def _unlimited(
    reference: TorqueReference, seen: FlexibilityState, motors: _Motors, velocity: Array, speed: Array, omega: float
) -> Array:
    out = np.empty(speed.size)
    for i in range(speed.size):
        error, error_rate = reference.torque[i] - seen.torque[i], reference.rate[i] - seen.rate[i]
        command = reference.second[i] + 2.0 * omega * error_rate + omega**2 * error
        bending = seen.stiffness_slope[i] * (velocity[i] - speed[i]) ** 2
        motor = seen.acceleration[i] - (command - bending) / seen.stiffness[i]
        out[i] = motors.inertia[i] * motor + motors.friction[i] * speed[i] - reference.torque[i]
    return out


@njit(cache=True, error_model="numpy")
def _slow_down(torque: Array, speed: Array, limit: Array) -> bool:
    """Set torques that accelerate a motor beyond its speed limit to zero; returns whether there were any."""
    found = False
    for i in range(torque.size):
        if abs(speed[i]) >= limit[i] and torque[i] * speed[i] > 0.0:
            torque[i], found = 0.0, True
    return found
