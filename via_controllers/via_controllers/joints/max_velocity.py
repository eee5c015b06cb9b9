"""Largest link velocity at a given time for a flexible joint with a torque motor: Section 7's policy in closed loop.

The motor follows theta_d(t) = theta(0) + integral of v s(t), with s = +-1 of the ideal motor (`visco_elastic`):

    tau = K_D (w_d - thd) - tau_e,    w_d = v s + K_P / K_D (theta_d - theta) within +-v,
    tau_e = tau_e(q - theta) + d (qd - thd)

The last term compensates the load of spring and damper. The motor catches up after a reversal, but never faster than v:
with K_P = B w^2 and K_D = 2 B w its speed converges like exp(-2 w t), without overshoot as long as 2 w is small
compared with the sample rate and the low passes. The times of s are those of a linear spring without gravity and
without friction of the link; other joints are refused, or slower than they could be (friction). The torque limit
reduces the velocity reached, as Figure 21 shows. After the horizon the motor holds its final reference. Velocities are
derivatives of angles behind low passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan, sqrt

import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked
from via_core.springs import SpringLaw

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, passive, require_positive
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_controllers.low_pass import low_passed

LINEAR = 0.02  # [-] largest relative change of the stiffness of a linear spring


@dataclass(frozen=True)
class MaxVelocityState:
    """State after a sample."""

    start: float  # [s] time of the first sample, NaN before it
    origin: float  # [rad] motor angle at the first sample
    time: float  # [s] of the last sample
    angles: Array  # (2,) [rad] of link and motor
    velocities: Array  # (2,) [rad/s] low-passed


@dataclass(frozen=True)
class MaxVelocity(Controller[MaxVelocityState]):
    """The controller. Raises ParameterError for gains, limits or a horizon that are not positive."""

    spring: SpringLaw
    damping: float  # d [N m s/rad] of the transmission
    horizon: float  # t_f [s]
    turns: tuple[float, ...]  # [s] after the start, rising: reversals of the motor
    velocity: float  # v [rad/s] of the motor
    proportional_gain: float  # K_P [N m/rad]
    derivative_gain: float  # K_D [N m s/rad]
    velocity_bandwidth: float  # [rad/s]
    torque_limit: float  # [N m]

    def __post_init__(self) -> None:
        require_positive(self, "horizon", "velocity", "proportional_gain", "velocity_bandwidth", "torque_limit")

    @classmethod
    def from_device(
        cls, device: Device, horizon: float, damping_command: float = 0.0, bandwidth: float = 100.0
    ) -> MaxVelocity:
        """The controller of a flexible device whose torque motor has torque and speed limits.

        horizon          t_f [s]
        damping_command  [0..1] of the damper during the motion
        bandwidth        w [rad/s] of the motor control
        """
        joint, motor = joint_of(device, damping_command), device.motors[0]
        if not isinstance(motor, TorqueMotor) or motor.torque_limit is None or motor.speed_limit is None:
            raise ParameterError(f"device: '{device.name}' has no torque motor with torque_limit and speed_limit")
        return cls(
            spring=device.springs[0],
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

    def observe(self, state: MaxVelocityState) -> Array:
        """Time left to t_f, negative after it, and the low-passed velocities."""
        return np.array([self.horizon - (state.time - state.start), *state.velocities])

    def init(self) -> MaxVelocityState:
        zeros = locked(np.zeros(2), "angles")
        return MaxVelocityState(nan, 0.0, 0.0, zeros, zeros)

    def step(self, state: MaxVelocityState, sample: JointSample) -> tuple[MaxVelocityState, Torques]:
        angles = np.array([sample.q, sample.theta[0]])
        if not sample.valid:
            return state, passive(1)
        if isnan(state.start):
            state = MaxVelocityState(sample.time, angles[1], sample.time, angles, np.zeros(2))
        step = sample.time - state.time
        velocities = low_passed(state.velocities, state.angles, angles, step, self.velocity_bandwidth)
        target, rate = self.reference(sample.time - state.start)
        load = self.spring.torque_at(angles[0] - angles[1]) + self.damping * (velocities[0] - velocities[1])
        catching_up = self.proportional_gain / self.derivative_gain * (state.origin + target - angles[1])
        speed = min(max(rate + catching_up, -self.velocity), self.velocity)
        torque = self.derivative_gain * (speed - velocities[1]) - load
        after = MaxVelocityState(
            state.start, state.origin, sample.time, locked(angles, "angles"), locked(velocities, "velocities")
        )
        return after, limited(np.array([torque]), np.array([self.torque_limit]))


def joint_of(device: Device, damping_command: float = 0.0) -> ViscoElasticJoint:
    """omega and D of a flexible device; raises ParameterError if it is not flexible, not linear, or feels gravity."""
    if device.arrangement != "flexible":
        raise ParameterError(
            f"device: max_velocity needs one spring and one motor, '{device.name}' is {device.arrangement}"
        )
    spring = device.springs[0]
    M, K, other = device.link.inertia, *(float(spring.stiffness(s * spring.max_deflection)) for s in (0.0, 0.5))
    if abs(other - K) > LINEAR * K or device.link.gravity_torque != 0.0:
        raise ParameterError(
            f"device: max_velocity needs a linear spring and no gravity, whose times of reversal are known; "
            f"'{device.name}' has a stiffness of {K:.3g} N m/rad at rest and {other:.3g} at half of max_deflection, "
            f"and a gravity torque of {device.link.gravity_torque:g} N m"
        )
    parallel = device.damper is not None and device.damper.site == "transmission"
    d = float(device.damping_of(damping_command)) if parallel else 0.0
    return ViscoElasticJoint(sqrt(K / M), d / (2.0 * sqrt(K * M)))
