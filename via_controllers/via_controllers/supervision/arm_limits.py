"""Limits of an arm's motors and springs, enforced for any controller: torques are changed before a limit is reached.

With phi = q - theta and B thdd = tau + tau_e - D thd every limit is a window for a motor's torque:

    speed       (-v - thd) / T <= thdd <= (v - thd) / T              thd approaches v like exp(-t / T)
    deflection  |phi| stays below p where  phidd + 2 k phid + k^2 phi <= k^2 p,  and likewise for -p
    torque      |tau| <= tau_max

A controller may drive its motors up to `drive_share` of their speed limit. The rest is reserved for following links
that accelerate, e.g. thrown by a spring at its stop. p is `deflection_share` of the stop and the final v `speed_share`
of the limit: torques are constant between samples, and external loads, which the model's qdd does not include, deflect
springs further than predicted. Where windows exclude each other, speed overrides deflection, and torque overrides both:
an impact that accelerates a link beyond the speed of its motor can still exceed the deflection limit.

Torques are constant between samples and may act a sample late. The distance x from the speed limit then obeys
x(n+1) = x(n) - (step / T) x(n-1), which does not swing if T is at least four samples. T is therefore at least SLOWEST
samples, and 1 / k as well. Loads are those of the model: where the torque of a spring is wrong by d, a motor at its
limit exceeds it by T d / B.
Source: exponential control barrier functions (Nguyen and Sreenath, ACC 2016), of relative degree one and two.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample, require, require_positive

TORQUE, SPEED, DEFLECTION = 1, 2, 4  # bits of Limit, as constants for the kernel
SLOWEST = 4.0  # samples


class Limit(IntFlag):
    """Limits that changed a torque."""

    NONE = 0
    TORQUE = TORQUE
    SPEED = SPEED
    DEFLECTION = DEFLECTION


LIMITS = tuple(Limit(bits) for bits in range(8))  # by their bits: Limit(bits) would be slow


class LimitedArm(Protocol):
    """Data of n flexible joints, e.g. `via_core.vsa_arms.VsaArm`."""

    @property
    def n(self) -> int: ...
    @property
    def motor_inertia(self) -> Array: ...  # B (n,) [kg m^2]
    @property
    def motor_friction(self) -> Array: ...  # D (n,) [N m s/rad]
    @property
    def torque_limit(self) -> Array: ...  # (n,) [N m], infinite without a limit, like the next two
    @property
    def speed_limit(self) -> Array: ...  # (n,) [rad/s] of the motors
    @property
    def deflection_limit(self) -> Array: ...  # (n,) [rad] of the springs

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """tau_e [N m] and the resulting qdd [rad/s^2], (n,) each."""


class _Motors(NamedTuple):
    """Constants of the motors, (n,) each."""

    inertia: Array  # B [kg m^2]
    friction: Array  # D [N m s/rad]
    torque_limit: Array  # [N m]
    drive_limit: Array  # [rad/s] that a controller may use
    speed_limit: Array  # [rad/s]
    deflection_limit: Array  # p [rad]


class _Motion(NamedTuple):
    """Motion of the joints, (n,) each."""

    q: Array  # [rad]
    velocity: Array  # [rad/s] of the links
    acceleration: Array  # [rad/s^2] of the links
    theta: Array  # [rad]
    speed: Array  # [rad/s] of the motors
    tau_e: Array  # [N m]


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """Limits of an arm. Raises ParameterError for times or shares outside the stated ranges."""

    arm: LimitedArm
    speed_time: float = 0.005  # T > 0 [s]
    deflection_rate: float = 60.0  # k > 0 [1/s]
    drive_share: float = 0.5  # of the speed limit, above 0 up to 1
    speed_share: float = 0.95  # likewise
    deflection_share: float = 0.7  # of the springs' stops, above 0 up to 1

    def __post_init__(self) -> None:
        shares = ("drive_share", "speed_share", "deflection_share")
        require_positive(self, "speed_time", "deflection_rate", *shares)
        for name in shares:
            value = getattr(self, name)
            require(value <= 1.0, f"{name} must be <= 1, got {value}")

    @property
    def unstated(self) -> str:
        """Limits that the file of the arm or joint does not state: names and numbers of motors."""
        found = {
            name: np.flatnonzero(np.isinf(getattr(self.arm, name))) + 1 for name in ("torque_limit", "speed_limit")
        }
        return ", ".join(f"{name} (motor {', '.join(map(str, each))})" for name, each in found.items() if each.size)

    @cached_property
    def _motors(self) -> _Motors:
        arm = self.arm
        return _Motors(
            inertia=arm.motor_inertia,
            friction=arm.motor_friction,
            torque_limit=arm.torque_limit,
            drive_limit=self.drive_share * arm.speed_limit,
            speed_limit=self.speed_share * arm.speed_limit,
            deflection_limit=self.deflection_share * arm.deflection_limit,
        )

    def kept(self, sample: ArmSample, torque: Array, step: float = 0.0) -> tuple[Array, Limit]:
        """The torques (n,) [N m] closest to `torque` that respect the limits, and the limits that changed them.

        step  [s] between samples; 0: unknown
        """
        tau_e, acceleration = self.arm.loads(sample.q, sample.q_velocity, sample.theta, sample.theta_velocity)
        motion = _Motion(sample.q, sample.q_velocity, acceleration, sample.theta, sample.theta_velocity, tau_e)
        out = np.array(torque, dtype=np.float64)
        least = SLOWEST * step  # [s]
        rate = min(self.deflection_rate, 1.0 / least) if least > 0.0 else self.deflection_rate
        return out, LIMITS[_keep(out, motion, self._motors, max(self.speed_time, least), rate)]


@njit(cache=True, error_model="numpy")
def _keep(torque: Array, motion: _Motion, motors: _Motors, T: float, k: float) -> int:
    """Clip `torque` (n,) in place to its windows; returns the bits of Limit that changed it.

    Where a torque is not finite, all are zero.
    """
    if not np.isfinite(torque).all():
        torque[:] = 0.0
        return TORQUE
    changed = 0
    for i in range(torque.size):
        speed, inertia = motion.speed[i], motors.inertia[i]
        load = motors.friction[i] * speed - motion.tau_e[i]
        middle = (
            motion.acceleration[i] + 2.0 * k * (motion.velocity[i] - speed) + k * k * (motion.q[i] - motion.theta[i])
        )
        room = k * k * motors.deflection_limit[i]
        windows = (
            (SPEED, (-motors.drive_limit[i] - speed) / T, (motors.drive_limit[i] - speed) / T),
            (DEFLECTION, middle - room, middle + room),
            (SPEED, (-motors.speed_limit[i] - speed) / T, (motors.speed_limit[i] - speed) / T),
        )
        for bit, low, high in windows:
            before = torque[i]
            torque[i] = min(max(before, inertia * low + load), inertia * high + load)
            if torque[i] != before:
                changed |= bit
        before = torque[i]
        torque[i] = min(max(before, -motors.torque_limit[i]), motors.torque_limit[i])
        if torque[i] != before:
            changed |= TORQUE
    return changed
