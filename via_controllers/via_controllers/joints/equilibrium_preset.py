"""Tracks a commanded equilibrium and stiffness of a joint of variable stiffness.

    theta_d from `motor_references` for the commanded angle and stiffness, approached at most at `speed`
    tau = -K_P (theta - theta_d) - K_D thd + tau_0,   tau_0,i = -tau_e,i(q_d - theta_d,i)

If an estimator provides the actual stiffness, one factor r corrects the spring laws: x = log r follows

    e = log(sigma_est / sigma_model(q, theta)),   s = s_est / sigma_est

as `correction` describes, and returns to 0, the spring laws of the file, while the estimator is not OK. The estimate is
compared with the model's stiffness at the measured angles and not with the commanded stiffness: motion that excites the
estimator changes both alike. The motors then move to where the model has the stiffness sigma_command / r. A joint at
rest does not excite the estimator: `fallback_time` is the time for which a correction outlasts the motion.
A preset motor of a serial joint has no static torque here: spring laws do not include the load of the preset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, isnan, log, nan

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked
from via_core.status import Status

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, passive, require
from via_controllers.correction import LARGEST_FACTOR, Correction, CorrectionRule
from via_controllers.joints.motor_references import MotorReferences, UnreachableError
from via_controllers.low_pass import low_passed

FURTHEST = 10.0  # [rad] largest angle commanded
NEAR = 5e-3  # relative change of r below which the motors keep their target


@dataclass(frozen=True)
class EquilibriumPresetState:
    """State after a sample; `time` is NaN before the first sample, `equilibrium` NaN before the first reference."""

    equilibrium: float  # [rad] commanded
    stiffness: float  # [N m/rad] commanded
    target: Array  # (2,) [rad] motor angles for the command
    target_factor: float  # r [-] for which the target was computed
    reached: bool  # False: the target has the closest stiffness within reach
    correction: Correction  # of log r [-]
    time: float  # [s] of the last sample
    q: float  # [rad] at that sample
    theta: Array  # (2,) [rad] at that sample
    reference: Array  # (2,) [rad] of the motors, moving to the target
    velocity: Array  # (2,) [rad/s] of the motors, low-passed

    @property
    def factor(self) -> float:
        """r [-], the correction factor of the spring laws."""
        return exp(self.correction.value)


@dataclass(frozen=True)
class EquilibriumPreset(Controller[EquilibriumPresetState]):
    """The controller. Raises ParameterError for gains, limits or times that are not positive."""

    references: MotorReferences
    proportional_gain: tuple[float, float]  # K_P [N m/rad] of each motor
    derivative_gain: tuple[float, float]  # K_D [N m s/rad]
    velocity_bandwidth: float  # [rad/s]
    torque_limit: tuple[float, float]  # [N m]
    speed: float = 2.0  # [rad/s] of the motor references
    correction_time: float = 1.0  # T [s]
    fallback_time: float = 30.0  # [s]
    trusted_deviation: float = 0.1  # S [-]

    def __post_init__(self) -> None:
        pairs, numbers = ("proportional_gain", "derivative_gain", "torque_limit"), ("velocity_bandwidth", "speed")
        for name in (*pairs, *numbers):
            value = min(getattr(self, name)) if name in pairs else getattr(self, name)
            require(value > 0.0, f"{name} must be > 0, got {value}")
        _ = self.rule

    @cached_property
    def rule(self) -> CorrectionRule:
        """The rule that log r follows."""
        limit = log(LARGEST_FACTOR)
        return CorrectionRule(self.correction_time, self.fallback_time, self.trusted_deviation, -limit, limit)

    @classmethod
    def from_device(cls, device: Device, bandwidth: float = 60.0) -> EquilibriumPreset:
        """The controller of a device with two torque motors; K_P = B w^2, K_D = 2 B w, w = `bandwidth` [rad/s]."""
        torque = device.torque_motors
        if len(device.motors) != 2 or len(torque) != 2:
            raise ParameterError(f"device: '{device.name}' has no two motors that take torques")
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

    def observe(self, state: EquilibriumPresetState) -> Array:
        """The command, whether it is within reach, and the correction factor of the spring laws."""
        return np.array([state.equilibrium, state.stiffness, state.reached, state.factor])

    def init(self) -> EquilibriumPresetState:
        zeros = locked(np.zeros(2), "theta")
        return EquilibriumPresetState(nan, nan, zeros, 1.0, True, Correction(), nan, nan, zeros, zeros, zeros)

    def with_reference(
        self, state: EquilibriumPresetState, equilibrium: float, stiffness: float
    ) -> EquilibriumPresetState:
        """`state` with this angle [rad] and stiffness [N m/rad] commanded.

        Raises UnreachableError if the angle is beyond FURTHEST or the spring laws do not reach the command. If only the
        corrected spring laws do not reach it, the target has the closest stiffness and `reached` is False.
        """
        if abs(equilibrium) > FURTHEST:
            raise UnreachableError(f"equilibrium must lie in [{-FURTHEST:g}, {FURTHEST:g}] rad, got {equilibrium:g}")
        nominal, reached = stiffness / state.factor, True
        try:
            target = self.references.at(equilibrium, nominal)
        except UnreachableError:
            low, high = self.references.stiffness_range(equilibrium)
            if not low <= stiffness <= high:
                raise
            target, reached = self.references.at(equilibrium, min(max(nominal, low), high)), False
        return replace(
            state, equilibrium=equilibrium, stiffness=stiffness, target=locked(target, "target"),
            target_factor=state.factor, reached=reached,
        )  # fmt: skip

    def with_estimate(
        self, state: EquilibriumPresetState, time: float, status: Status, value: float, standard_deviation: float
    ) -> EquilibriumPresetState:
        """`state` with an estimate of the device's stiffness [N m/rad] at `time` [s], in the time of samples."""
        if isnan(state.time):
            return state
        nominal = float(self.references.device.stiffness(state.q, state.theta))
        good = status == Status.OK and value > 0.0 and nominal > 0.0
        ratio, relative_sd = (log(value / nominal), standard_deviation / value) if good else (0.0, 0.0)
        usable = status if good or status != Status.OK else Status.BAD_SAMPLE
        return replace(state, correction=self.rule.informed(state.correction, time, usable, ratio, relative_sd))

    def step(self, state: EquilibriumPresetState, sample: JointSample) -> tuple[EquilibriumPresetState, Torques]:
        if not sample.valid:
            return state, passive(2)
        theta = locked(sample.theta, "theta")
        if isnan(state.time):
            state = replace(state, time=sample.time, theta=theta, reference=theta)
        step = max(sample.time - state.time, 0.0)
        velocity = locked(low_passed(state.velocity, state.theta, theta, step, self.velocity_bandwidth), "velocity")
        state = replace(state, time=max(sample.time, state.time), q=sample.q, theta=theta, velocity=velocity)
        if isnan(state.equilibrium):
            return state, passive(2)  # no reference yet
        state = replace(state, correction=self.rule.advanced(state.correction, state.time, step))
        ended = state.factor == 1.0 != state.target_factor
        if ended or abs(state.factor / state.target_factor - 1.0) > NEAR:
            state = self.with_reference(state, state.equilibrium, state.stiffness)
        change = np.clip(state.target - state.reference, -self.speed * step, self.speed * step)
        reference = locked(state.reference + change, "reference")
        torque = (
            self._static(state.equilibrium, reference)
            - np.array(self.derivative_gain) * velocity
            - np.array(self.proportional_gain) * (theta - reference)
        )
        return replace(state, reference=reference), limited(torque, np.array(self.torque_limit))

    def _static(self, q: float, theta: Array) -> Array:
        """Motor torques (2,) [N m] that balance the springs with the link at `q` [rad]; 0 for a preset motor."""
        device = self.references.device
        each = -device.torque_each(q, theta)
        return np.append(each, np.zeros(2 - len(each)))
