"""Motor position control of an antagonistic joint: eq. (120) with the static torque that the printed form lacks.

    tau = -K_D thd - K_P (theta - theta_d) + tau_0,        tau_0,i = -tau_e,i(x - theta_d,i)

theta_d = (x + s, x - s) for an equilibrium x and a preset s. Without tau_0 the springs shift the motors from their
reference by K_P^-1 tau_e. x(t) and s(t) are multisines, which excite deflection and stiffness for identification.
The references fade in from the motor angles of the first sample, without a jump:
theta_d = (1 - f) theta(0) + f (x + s, x - s) with f = u^2 (3 - 2u), u = t / fade_in.
Motor velocities are not measured: they are derivatives of the angles behind a first-order low pass of bandwidth w_f.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, isnan, nan

import numpy as np
from via_core.signals import Array, locked
from via_core.springs import SpringLaw

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, passive, require
from via_controllers.joints.multisine import Multisine
from via_controllers.low_pass import low_passed

LARGEST = 1e6  # [rad] larger motor angles are transmission errors, which would corrupt the velocity estimate


@dataclass(frozen=True)
class MotorPositionState:
    """State after a sample."""

    start: float  # [s] time of the first sample, NaN before it
    origin: Array  # (2,) [rad] motor angles of the first sample
    time: float  # [s] of the last sample
    theta: Array  # (2,) [rad]
    velocity: Array  # (2,) [rad/s] low-passed


@dataclass(frozen=True)
class MotorPositionControl(Controller[MotorPositionState]):
    """The controller. Raises ParameterError for gains or limits that are not positive."""

    springs: tuple[SpringLaw, SpringLaw]  # nominal spring laws of the two transmissions
    equilibrium: Multisine  # x(t) [rad]
    preset: Multisine  # s(t) [rad]
    proportional_gain: float  # K_P [N m/rad]
    derivative_gain: float  # K_D [N m s/rad]
    velocity_bandwidth: float  # w_f [rad/s]
    torque_limit: tuple[float, float]  # [N m]
    fade_in: float  # [s]

    def __post_init__(self) -> None:
        require(len(self.springs) == 2, f"an antagonistic joint has 2 springs, got {len(self.springs)}")
        positive = {
            "proportional_gain": self.proportional_gain,
            "velocity_bandwidth": self.velocity_bandwidth,
            "torque_limit": min(self.torque_limit),
            "fade_in": self.fade_in,
        }
        for name, value in positive.items():
            require(value > 0.0, f"{name} must be > 0, got {value}")
        require(self.derivative_gain >= 0.0, f"derivative_gain must be >= 0, got {self.derivative_gain}")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("equilibrium", "rad"), Quantity("preset", "rad")

    def observe(self, state: MotorPositionState) -> Array:
        """x and s of the references; NaN before the first sample."""
        if isnan(state.start):
            return np.full(2, nan)
        first, second = self.references(state.time - state.start, state.origin)
        return np.array([0.5 * (first + second), 0.5 * (first - second)])

    def init(self) -> MotorPositionState:
        zeros = locked(np.zeros(2), "theta")
        return MotorPositionState(nan, zeros, 0.0, zeros, zeros)

    def references(self, time: float, origin: Array) -> Array:
        """theta_d (2,) [rad] at `time` [s] since the start at the motor angles `origin` (2,) [rad]."""
        x, s = self.equilibrium.at(time), self.preset.at(time)
        u = min(time / self.fade_in, 1.0)
        fade = u * u * (3.0 - 2.0 * u)
        return (1.0 - fade) * origin + fade * np.array([x + s, x - s])

    def step(self, state: MotorPositionState, sample: JointSample) -> tuple[MotorPositionState, Torques]:
        if not (isfinite(sample.time) and np.abs(sample.theta).max() < LARGEST):  # the link angle is not used
            return state, passive(2)
        if isnan(state.start):
            theta = locked(sample.theta, "origin")
            state = MotorPositionState(sample.time, theta, sample.time, theta, np.zeros(2))
        step = sample.time - state.time
        velocity = low_passed(state.velocity, state.theta, sample.theta, step, self.velocity_bandwidth)

        theta_d = self.references(sample.time - state.start, state.origin)
        x = 0.5 * (theta_d[0] + theta_d[1])
        tau_0 = -np.array([spring.torque_at(x - d) for spring, d in zip(self.springs, theta_d, strict=True)])
        torque = tau_0 - self.derivative_gain * velocity - self.proportional_gain * (sample.theta - theta_d)
        theta, velocity = locked(sample.theta, "theta"), locked(velocity, "velocity")
        after = MotorPositionState(state.start, state.origin, sample.time, theta, velocity)
        return after, limited(torque, np.asarray(self.torque_limit))
