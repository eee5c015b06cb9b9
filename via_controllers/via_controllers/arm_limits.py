"""Limits of an arm's motors and springs, kept whatever a law wants: torque is taken back before they are reached.

With phi = q - theta and B thdd = tau + tau_e - D thd every limit is a window for a motor's torque:

    speed       (-v - thd) / T <= thdd <= (v - thd) / T          thd closes up to v like exp(-t / T)
    deflection  |phi| stays below p where  phidd + 2 k phid + k^2 phi <= k^2 p,  and the same to the other side
    torque      |tau| <= tau_max

p and v lie `margin` inside the limits, for torques are held between samples and loads on the links, which qdd of the
model does not know, push springs further than it says. Where windows exclude each other, speed goes before deflection
and torque before both: a link that is thrown harder than its motor can follow bends its spring all the same.
Source: exponential control barrier functions (Nguyen and Sreenath, ACC 2016), of relative degree one and two.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_controllers.contract import ArmSample, require


class Limit(IntFlag):
    """Which limits changed a torque."""

    NONE = 0
    TORQUE = 1
    SPEED = 2
    DEFLECTION = 4


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """The limits of this file. Raises ParameterError for times or margins outside of what is said here."""

    arm: VsaArm
    speed_time: float = 0.005  # T > 0 [s]
    deflection_rate: float = 60.0  # k > 0 [1/s]
    margin: float = 0.05  # [-] of a limit, 0 to .5

    def __post_init__(self) -> None:
        for name in ("speed_time", "deflection_rate"):
            value = getattr(self, name)
            require(np.isfinite(value) and value > 0.0, f"{name} must be > 0, got {value}")
        require(0.0 <= self.margin <= 0.5, f"margin must be 0 to .5, got {self.margin}")

    def kept(self, sample: ArmSample, torque: Array) -> tuple[Array, Limit]:
        """The torques (n,) [N m] nearest to `torque` that keep the limits, and which ones changed them."""
        arm = self.arm
        if not np.isfinite(torque).all():
            return np.zeros(arm.n), Limit.TORQUE
        tau_e, _, _ = arm.spring_state(sample.q - sample.theta)
        acceleration = arm.link_acceleration(sample.q, sample.q_velocity, -tau_e)
        out = np.array(torque)
        changed = _kept(
            out, sample.q - sample.theta, sample.q_velocity - sample.theta_velocity, acceleration,
            sample.theta_velocity, arm.motor_friction * sample.theta_velocity - tau_e, arm.motor_inertia,
            arm.torque_limit, arm.speed_limit * (1.0 - self.margin), arm.deflection_limit * (1.0 - self.margin),
            self.speed_time, self.deflection_rate,
        )  # fmt: skip
        return out, Limit(changed)


@njit(cache=True, error_model="numpy")
def _kept(
    torque: Array, phi: Array, phi_rate: Array, acceleration: Array, speed: Array, load: Array, inertia: Array,
    torque_limit: Array, speed_limit: Array, deflection_limit: Array, T: float, k: float,
) -> int:  # fmt: skip
    """`torque` (n,) brought within its windows; the bits of Limit that did it. `load` = D thd - tau_e (n,) [N m]."""
    changed = 0
    for i in range(torque.size):
        before = torque[i]
        bending = acceleration[i] + 2.0 * k * phi_rate[i]
        # thdd at which phi only just stays within its limits
        low = inertia[i] * (bending - k * k * (deflection_limit[i] - phi[i])) + load[i]
        high = inertia[i] * (bending + k * k * (deflection_limit[i] + phi[i])) + load[i]
        after = min(max(before, low), high)
        if after != before:
            changed |= 4
        before = after
        low = inertia[i] * (-speed_limit[i] - speed[i]) / T + load[i]
        high = inertia[i] * (speed_limit[i] - speed[i]) / T + load[i]
        after = min(max(before, low), high)
        if after != before:
            changed |= 2
        before = after
        after = min(max(before, -torque_limit[i]), torque_limit[i])
        if after != before:
            changed |= 1
        torque[i] = after
    return changed
