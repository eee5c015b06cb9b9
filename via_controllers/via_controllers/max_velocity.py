"""The fastest link at a given time, on a joint whose motor takes torques: Section 7's policy, run in closed loop.

The motor follows theta_d(t) = theta(0) + integral of v s(t), s = +-1 as `visco_elastic` has it for an ideal motor:

    tau = K_D (w_d - thd) - tau_e,    w_d = v s + K_P / K_D (theta_d - theta) within +-v,
    tau_e = tau_e(q - theta) + d (qd - thd)

The last term takes the load of spring and damper off the motor. What a turn costs is made up for afterwards, but never
faster than v: with K_P = B w^2 and K_D = 2 B w the motor's speed closes up like exp(-2 w t), without overshoot as long
as 2 w is small beside the rates of samples and of the low passes. The torque is limited, which costs what Figure 21
shows. After the horizon the motor holds still where it is to be. Velocities are not measured: they are derivatives of
angles behind low passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, isnan, nan, sqrt

import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked
from via_core.springs import SpringLaw

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, require
from via_controllers.low_pass import low_passed
from via_controllers.visco_elastic import ViscoElasticJoint


@dataclass(frozen=True)
class MaxVelocityState:
    """`start` is the stamp [s] of the first sample, NaN before it, `origin` [rad] the motor's angle there."""

    start: float
    origin: float
    time: float  # [s] of the last sample
    angles: Array  # (2,) [rad] of link and motor
    velocities: Array  # (2,) [rad/s] low-passed


@dataclass(frozen=True)
class MaxVelocity(Controller[MaxVelocityState]):
    """The law of this file. Raises ParameterError for gains, limits or a horizon that are not positive."""

    spring: SpringLaw
    damping: float  # d [N m s/rad] of the transmission
    horizon: float  # t_f [s]
    turns: tuple[float, ...]  # [s] after the start, rising, at which the motor turns around
    velocity: float  # v [rad/s] of the motor
    proportional_gain: float  # K_P [N m/rad]
    derivative_gain: float  # K_D [N m s/rad]
    velocity_bandwidth: float  # [rad/s]
    torque_limit: float  # [N m]

    def __post_init__(self) -> None:
        for name in ("horizon", "velocity", "proportional_gain", "velocity_bandwidth", "torque_limit"):
            value = getattr(self, name)
            require(isfinite(value) and value > 0.0, f"{name} must be > 0, got {value}")

    @classmethod
    def from_device(
        cls, device: Device, horizon: float, damping_command: float = 0.0, bandwidth: float = 100.0
    ) -> MaxVelocity:
        """For a flexible device with a torque motor whose torque and speed limits are known.

        horizon          t_f [s]
        damping_command  [0..1] under which the damper stands meanwhile
        bandwidth        w [rad/s] of the motor's loop
        """
        joint, motor = joint_of(device, damping_command), device.motors[0]
        if not isinstance(motor, TorqueMotor) or motor.torque_limit is None or motor.speed_limit is None:
            raise ParameterError(f"device: '{device.name}' has no torque motor with torque_limit and speed_limit")
        return cls(
            spring=device.spring_laws[0],
            damping=2.0 * joint.damping_ratio * joint.frequency * device.link.inertia,
            horizon=horizon,
            turns=tuple(joint.turns(horizon)),
            velocity=motor.speed_limit,
            proportional_gain=motor.inertia * bandwidth**2,
            derivative_gain=2.0 * motor.inertia * bandwidth,
            velocity_bandwidth=10.0 * bandwidth,
            torque_limit=motor.torque_limit,
        )

    def reference(self, time: float) -> tuple[float, float]:
        """theta_d - theta(0) [rad] and its rate [rad/s] at `time` [s] since the start."""
        ends = np.array([0.0, *self.turns, self.horizon])
        signs = np.where(np.arange(len(ends) - 1)[::-1] % 2, -1.0, 1.0)
        there = float(signs @ np.diff(np.clip(ends, None, max(time, 0.0))))
        left = sum(turn > time for turn in self.turns)
        moving = 0.0 <= time < self.horizon
        return self.velocity * there, self.velocity * (-1.0) ** left * moving

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("left", "s"), Quantity("link_velocity", "rad/s"), Quantity("motor_velocity", "rad/s")

    def told(self, state: MaxVelocityState) -> Array:
        """How long it is to t_f, below 0 after it, and the velocities behind their low passes."""
        return np.array([self.horizon - (state.time - state.start), *state.velocities])

    def init(self) -> MaxVelocityState:
        nothing = locked(np.zeros(2), "angles")
        return MaxVelocityState(nan, 0.0, 0.0, nothing, nothing)

    def step(self, state: MaxVelocityState, sample: JointSample) -> tuple[MaxVelocityState, Torques]:
        angles = np.array([sample.q, sample.theta[0]])
        if not (isfinite(sample.time) and np.isfinite(angles).all()):
            return state, Torques(np.zeros(1), False)  # blind: passive
        if isnan(state.start):
            state = MaxVelocityState(sample.time, angles[1], sample.time, angles, np.zeros(2))
        step = sample.time - state.time
        velocities = low_passed(state.velocities, state.angles, angles, step, self.velocity_bandwidth)
        wanted, rate = self.reference(sample.time - state.start)
        load = float(self.spring.torque(angles[0] - angles[1])) + self.damping * (velocities[0] - velocities[1])
        catching_up = self.proportional_gain / self.derivative_gain * (state.origin + wanted - angles[1])
        speed = min(max(rate + catching_up, -self.velocity), self.velocity)
        torque = self.derivative_gain * (speed - velocities[1]) - load
        after = MaxVelocityState(
            state.start, state.origin, sample.time, locked(angles, "angles"), locked(velocities, "velocities")
        )
        return after, limited(np.array([torque]), np.array([self.torque_limit]))


def joint_of(device: Device, damping_command: float = 0.0) -> ViscoElasticJoint:
    """omega and D of a flexible device at rest; raises ParameterError where it is not flexible."""
    if device.arrangement != "flexible":
        raise ParameterError(f"device: fastest motions need one spring and one motor, '{device.name}' has not")
    M, K = device.link.inertia, float(device.spring_laws[0].stiffness(0.0))
    beside = device.damper is not None and device.damper.site == "transmission"
    d = float(device.damping_of(damping_command)) if beside else 0.0
    return ViscoElasticJoint(sqrt(K / M), d / (2.0 * sqrt(K * M)))
