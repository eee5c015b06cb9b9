"""Limits of an arm's motors and springs, kept whatever a law wants: torque is taken back before they are reached.

With phi = q - theta and B thdd = tau + tau_e - D thd every limit is a window for a motor's torque:

    speed       (-v - thd) / T <= thdd <= (v - thd) / T              thd closes up to v like exp(-t / T)
    deflection  |phi| stays below p where  phidd + 2 k phid + k^2 phi <= k^2 p,  and the same to the other side
    torque      |tau| <= tau_max

A law may drive its motors up to `drive_share` of their speed limit: the rest is there to follow links that are thrown,
and is needed, for a spring at its stop throws its link as fast as such motors go. p is `deflection_share` of the stop,
v in the end `speed_share` of the limit: torques are held between samples, and loads on the links, which qdd of the
model does not know, bend springs further than it says. Where windows exclude each other, speed goes before deflection
and torque before both: a link that a blow makes faster than its motor bends its spring all the same.
Source: exponential control barrier functions (Nguyen and Sreenath, ACC 2016), of relative degree one and two.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag
from typing import Protocol

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample, require, require_positive


class Limit(IntFlag):
    """Which limits changed a torque."""

    NONE = 0
    TORQUE = 1
    SPEED = 2
    DEFLECTION = 4


class LimitedArm(Protocol):
    """What must be known of n flexible joints; `via_core.vsa_arms.VsaArm` knows it."""

    @property
    def n(self) -> int: ...
    @property
    def motor_inertia(self) -> Array: ...  # B (n,) [kg m^2]
    @property
    def motor_friction(self) -> Array: ...  # D (n,) [N m s/rad]
    @property
    def torque_limit(self) -> Array: ...  # (n,) [N m], infinite where there is none, as those that follow
    @property
    def speed_limit(self) -> Array: ...  # (n,) [rad/s] of the motors
    @property
    def deflection_limit(self) -> Array: ...  # (n,) [rad] of the springs

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """tau_e [N m] and qdd [rad/s^2] under it, (n,) each."""


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """The limits of this file. Raises ParameterError for times or margins outside of what is said here."""

    arm: LimitedArm
    speed_time: float = 0.005  # T > 0 [s]
    deflection_rate: float = 60.0  # k > 0 [1/s]
    drive_share: float = 0.5  # of the speed limit, 0 to 1
    speed_share: float = 0.95  # likewise
    deflection_share: float = 0.7  # of the springs' stops, 0 to 1
    _shares: tuple[Array, ...] = field(init=False, repr=False)  # limits (n,) in the order of `_kept`

    def __post_init__(self) -> None:
        shares = ("drive_share", "speed_share", "deflection_share")
        require_positive(self, "speed_time", "deflection_rate", *shares)
        for name in shares:
            value = getattr(self, name)
            require(value <= 1.0, f"{name} must be <= 1, got {value}")
        arm = self.arm
        limits = (
            arm.torque_limit,
            self.drive_share * arm.speed_limit,
            self.speed_share * arm.speed_limit,
            self.deflection_share * arm.deflection_limit,
        )
        object.__setattr__(self, "_shares", limits)

    def kept(self, sample: ArmSample, torque: Array) -> tuple[Array, Limit]:
        """The torques (n,) [N m] nearest to `torque` that keep the limits, and which ones changed them."""
        arm = self.arm
        if not np.isfinite(torque).all():
            return np.zeros(arm.n), Limit.TORQUE
        tau_e, acceleration = arm.loads(sample.q, sample.q_velocity, sample.theta, sample.theta_velocity)
        out = np.array(torque)
        changed = _kept(
            out, sample.q, sample.q_velocity, acceleration, sample.theta, sample.theta_velocity, tau_e,
            arm.motor_friction, arm.motor_inertia, *self._shares, self.speed_time, self.deflection_rate,
        )  # fmt: skip
        return out, Limit(changed)


@njit(cache=True, error_model="numpy")
def _kept(
    torque: Array, q: Array, velocity: Array, acceleration: Array, theta: Array, speed: Array, tau_e: Array,
    friction: Array, inertia: Array, torque_limit: Array, drive_limit: Array, speed_limit: Array,
    deflection_limit: Array, T: float, k: float,
) -> int:  # fmt: skip
    """`torque` (n,) brought within its windows; the bits of Limit that did it."""
    changed = 0
    for i in range(torque.size):
        load = friction[i] * speed[i] - tau_e[i]
        middle = acceleration[i] + 2.0 * k * (velocity[i] - speed[i]) + k * k * (q[i] - theta[i])
        room = k * k * deflection_limit[i]
        windows = (
            (2, (-drive_limit[i] - speed[i]) / T, (drive_limit[i] - speed[i]) / T),
            (4, middle - room, middle + room),
            (2, (-speed_limit[i] - speed[i]) / T, (speed_limit[i] - speed[i]) / T),
        )
        for bit, low, high in windows:
            before = torque[i]
            torque[i] = min(max(before, inertia[i] * low + load), inertia[i] * high + load)
            if torque[i] != before:
                changed |= bit
        before = torque[i]
        torque[i] = min(max(before, -torque_limit[i]), torque_limit[i])
        if torque[i] != before:
            changed |= 1
    return changed
