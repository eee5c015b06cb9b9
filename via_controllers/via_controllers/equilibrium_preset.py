"""What a user expects of a joint of variable stiffness: stand at an angle, be as stiff as told.

    theta_d by `motor_references` for the angle and the stiffness wanted, approached no faster than `speed`
    tau = -K_P (theta - theta_d) - K_D thd + tau_0,   tau_0,i = -tau_e,i(q_d - theta_d,i)

and, where an estimator says how stiff the joint really is, a correction of the spring laws by one factor r:

    e = log(sigma_est / sigma_law(q, theta)),   log r' = (e - log r) / T * 1 / (1 + (s_est / (S sigma_est))^2)

The law's stiffness at the measured angles, not the stiffness wanted, is what the estimate is compared with: motion that
excites the estimator changes both alike. The motors then stand where the law says sigma_wanted / r. An estimate counts
by its standard deviation s_est, half at S of its value, and only with status OK: without one the correction stays.
A serial joint's preset motor has no static torque here: its spring laws do not tell what the preset costs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, isfinite, isnan, log, nan

import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked
from via_core.status import Status

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, require
from via_controllers.low_pass import low_passed
from via_controllers.motor_references import MotorReferences, UnreachableError

LARGEST_FACTOR = 3.0  # that spring laws may be wrong by, either way
NEAR = 5e-3  # change of r for which the motors are not moved
LONGEST = 0.1  # [s] between estimates: after a longer gap the correction goes on as if it had been this


@dataclass(frozen=True)
class EquilibriumPresetState:
    """Where the law stands; `time` NaN before the first sample, `equilibrium` NaN before the first wish."""

    equilibrium: float  # [rad] wanted
    stiffness: float  # [N m/rad] wanted
    target: Array  # (2,) [rad] motor angles for it
    aimed: float  # r [-] when they were found
    reached: bool  # the target is for what is wanted; else for the closest stiffness that is reached
    factor: float  # r [-]
    factor_time: float  # [s] of the last estimate that counted, NaN before
    time: float  # [s] of the last sample
    q: float  # [rad] then
    theta: Array  # (2,) [rad] then
    reference: Array  # (2,) [rad] on the way to the target
    velocity: Array  # (2,) [rad/s] of the motors, low-passed


@dataclass(frozen=True)
class EquilibriumPreset(Controller[EquilibriumPresetState]):
    """The law of this file. Raises ParameterError for gains, limits or times that are not positive."""

    references: MotorReferences
    proportional_gain: tuple[float, float]  # K_P [N m/rad] of each motor
    derivative_gain: tuple[float, float]  # K_D [N m s/rad]
    velocity_bandwidth: float  # [rad/s]
    torque_limit: tuple[float, float]  # [N m]
    speed: float = 2.0  # [rad/s] of a reference
    correction_time: float = 1.0  # T [s]
    trusted_deviation: float = 0.1  # S [-]

    def __post_init__(self) -> None:
        positive = {
            "proportional_gain": min(self.proportional_gain),
            "derivative_gain": min(self.derivative_gain),
            "velocity_bandwidth": self.velocity_bandwidth,
            "torque_limit": min(self.torque_limit),
            "speed": self.speed,
            "correction_time": self.correction_time,
            "trusted_deviation": self.trusted_deviation,
        }
        for name, value in positive.items():
            require(value > 0.0, f"{name} must be > 0, got {value}")

    @classmethod
    def from_device(cls, device: Device, bandwidth: float = 60.0) -> EquilibriumPreset:
        """For a device of two torque motors; K_P = B w^2, K_D = 2 B w, w = `bandwidth` [rad/s]."""
        motors = device.motors
        if len(motors) != 2 or not all(isinstance(motor, TorqueMotor) for motor in motors):
            raise ParameterError(f"device: '{device.name}' has no two motors that take torques")
        torque = [motor for motor in motors if isinstance(motor, TorqueMotor)]
        inertia = [motor.inertia for motor in torque]
        first, second = (np.inf if motor.torque_limit is None else motor.torque_limit for motor in torque)
        return cls(
            references=MotorReferences.from_device(device),
            proportional_gain=(inertia[0] * bandwidth**2, inertia[1] * bandwidth**2),
            derivative_gain=(2.0 * inertia[0] * bandwidth, 2.0 * inertia[1] * bandwidth),
            velocity_bandwidth=5.0 * bandwidth,
            torque_limit=(first, second),
        )

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return (
            Quantity("equilibrium", "rad"),
            Quantity("stiffness", "N m/rad"),
            Quantity("reached", "-"),
            Quantity("factor", "-"),
        )

    def told(self, state: EquilibriumPresetState) -> Array:
        """What is wanted, whether the motors stand for it, and by how much the spring laws were found to be wrong."""
        return np.array([state.equilibrium, state.stiffness, state.reached, state.factor])

    def init(self) -> EquilibriumPresetState:
        nothing = locked(np.zeros(2), "theta")
        return EquilibriumPresetState(nan, nan, nothing, 1.0, True, 1.0, nan, nan, nan, nothing, nothing, nothing)

    def towards(self, state: EquilibriumPresetState, equilibrium: float, stiffness: float) -> EquilibriumPresetState:
        """The state in which this angle [rad] and stiffness [N m/rad] are wanted; raises UnreachableError by the laws.

        Where only the corrected laws do not reach it, the closest stiffness that they reach is taken, and said.
        """
        asked, reached = stiffness / state.factor, True
        try:
            target = self.references.at(equilibrium, asked)
        except UnreachableError:
            low, high = self.references.stiffness_range(equilibrium)
            if not low <= stiffness <= high:
                raise
            target, reached = self.references.at(equilibrium, min(max(asked, low), high)), False
        return replace(
            state, equilibrium=equilibrium, stiffness=stiffness, target=locked(target, "target"), aimed=state.factor,
            reached=reached,
        )  # fmt: skip

    def estimated(
        self, state: EquilibriumPresetState, time: float, status: Status, value: float, deviation: float
    ) -> EquilibriumPresetState:
        """The state that knows an estimate of the device's stiffness, with its deviation [N m/rad], at `time` [s]."""
        good = status == Status.OK and value > 0.0 and isfinite(value) and isfinite(deviation) and isfinite(time)
        if not good or isnan(state.time) or isnan(state.equilibrium):
            return state
        by_law = float(self.references.device.stiffness(state.q, state.theta))
        if not by_law > 0.0:
            return state
        step = min(max(time - state.factor_time, 0.0), LONGEST) if isfinite(state.factor_time) else 0.0
        weight = 1.0 / (1.0 + (deviation / (self.trusted_deviation * value)) ** 2)
        follow = -np.expm1(-step * weight / self.correction_time)
        limit = log(LARGEST_FACTOR)
        wrong = min(max(log(value / by_law), -limit), limit)
        factor = exp(log(state.factor) + follow * (wrong - log(state.factor)))
        state = replace(state, factor=factor, factor_time=max(time, state.factor_time) if step else time)
        if abs(factor / state.aimed - 1.0) <= NEAR:
            return state
        return self.towards(state, state.equilibrium, state.stiffness)

    def step(self, state: EquilibriumPresetState, sample: JointSample) -> tuple[EquilibriumPresetState, Torques]:
        if not (isfinite(sample.time) and isfinite(sample.q) and np.isfinite(sample.theta).all()):
            return state, Torques(np.zeros(2), False)  # blind: passive
        theta = locked(sample.theta, "theta")
        if isnan(state.time):
            state = replace(state, time=sample.time, theta=theta, reference=theta)
        step = max(sample.time - state.time, 0.0)
        velocity = locked(low_passed(state.velocity, state.theta, theta, step, self.velocity_bandwidth), "velocity")
        state = replace(state, time=max(sample.time, state.time), q=sample.q, theta=theta, velocity=velocity)
        if isnan(state.equilibrium):
            return state, Torques(np.zeros(2), False)  # nothing is wanted yet
        way = np.clip(state.target - state.reference, -self.speed * step, self.speed * step)
        reference = locked(state.reference + way, "reference")
        torque = (
            self._static(state.equilibrium, reference)
            - np.array(self.derivative_gain) * velocity
            - np.array(self.proportional_gain) * (theta - reference)
        )
        return replace(state, reference=reference), limited(torque, np.array(self.torque_limit))

    def _static(self, q: float, theta: Array) -> Array:
        """Motor torques (2,) [N m] that hold springs whose link is at `q`; 0 where a spring law has no say."""
        device = self.references.device
        each = -device.torque_each(q, theta)
        return np.append(each, np.zeros(2 - len(each)))
