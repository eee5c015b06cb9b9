"""Motor position control of an antagonistic joint: eq. (120) with the static torque that the printed form lacks.

    tau = -K_D thd - K_P (theta - theta_d) + tau_0,        tau_0,i = -tau_e,i(x - theta_d,i)

theta_d = (x + s, x - s) for an equilibrium x and a preset s. Without tau_0 the springs pull the motors off their
reference by K_P^-1 tau_e. x(t) and s(t) are multisines, so that the law excites deflection and stiffness on purpose.
The references fade in from where the first sample finds the motors, so that nothing jerks:
theta_d = (1 - f) theta(0) + f (x + s, x - s) with f = u^2 (3 - 2u), u = t / fade_in.
The motor velocity is not measured; it is the angle's derivative behind a first-order low pass of bandwidth w_f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, isnan, nan

import numpy as np
from via_core.signals import Array, locked
from via_core.springs import SpringLaw

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, require
from via_controllers.low_pass import low_passed
from via_controllers.multisine import Multisine

LARGEST = 1e6  # [rad] an angle no motor reaches: noise on the wire, which the velocity would remember


@dataclass(frozen=True)
class MotorPositionState:
    """Where the law stands; `start` is the stamp [s] from which the references count, NaN before the first sample."""

    start: float
    origin: Array  # (2,) [rad] motor angles of the first sample
    time: float  # [s] stamp of the last sample
    theta: Array  # (2,) [rad]
    velocity: Array  # (2,) [rad/s] low-passed


@dataclass(frozen=True)
class MotorPositionControl(Controller[MotorPositionState]):
    """The law of this file. Raises ParameterError for gains or limits that are not positive."""

    springs: tuple[SpringLaw, SpringLaw]  # nominal laws of the two transmissions
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

    def told(self, state: MotorPositionState) -> Array:
        """x and s of the references; NaN before the first sample."""
        if isnan(state.start):
            return np.full(2, nan)
        first, second = self.references(state.time - state.start, state.origin)
        return np.array([0.5 * (first + second), 0.5 * (first - second)])

    def init(self) -> MotorPositionState:
        nothing = locked(np.zeros(2), "theta")
        return MotorPositionState(nan, nothing, 0.0, nothing, nothing)

    def references(self, time: float, origin: Array) -> Array:
        """theta_d (2,) [rad] at `time` [s] since the start at the motor angles `origin` (2,) [rad]."""
        x, s = self.equilibrium.at(time), self.preset.at(time)
        u = min(time / self.fade_in, 1.0)
        fade = u * u * (3.0 - 2.0 * u)
        return (1.0 - fade) * origin + fade * np.array([x + s, x - s])

    def step(self, state: MotorPositionState, sample: JointSample) -> tuple[MotorPositionState, Torques]:
        if not (isfinite(sample.time) and np.all(np.abs(sample.theta) < LARGEST)):
            return state, Torques(np.zeros(2), False)  # blind: passive, and the velocity stays what it was
        if isnan(state.start):
            here = locked(sample.theta, "origin")
            state = MotorPositionState(sample.time, here, sample.time, here, np.zeros(2))
        step = sample.time - state.time
        velocity = low_passed(state.velocity, state.theta, sample.theta, step, self.velocity_bandwidth)

        theta_d = self.references(sample.time - state.start, state.origin)
        x = 0.5 * (theta_d[0] + theta_d[1])
        tau_0 = -np.array([float(law.torque(x - d)) for law, d in zip(self.springs, theta_d, strict=True)])
        torque = tau_0 - self.derivative_gain * velocity - self.proportional_gain * (sample.theta - theta_d)
        after = replace(
            state, time=sample.time, theta=locked(sample.theta, "theta"), velocity=locked(velocity, "velocity")
        )
        return after, limited(torque, np.asarray(self.torque_limit))
