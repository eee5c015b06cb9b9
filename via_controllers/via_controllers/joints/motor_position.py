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
from functools import cached_property
from math import isfinite, isnan, nan
from typing import NamedTuple

import numpy as np
from numba import njit
from via_core.signals import Array, locked
from via_core.spring_equations import spring_torque
from via_core.springs import SpringLaw

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited_torque, passive, require
from via_controllers.joints.multisine import Multisine, multisine
from via_controllers.low_pass import LARGEST, low_passed


@dataclass(frozen=True)
class MotorPositionState:
    """State after a sample."""

    start: float  # [s] time of the first sample, NaN before it
    origin: Array  # (2,) [rad] motor angles of the first sample
    time: float  # [s] of the last sample
    theta: Array  # (2,) [rad]
    velocity: Array  # (2,) [rad/s] low-passed
    reference: Array  # theta_d (2,) [rad], NaN before the first sample


class _Constants(NamedTuple):
    """Constants of the compiled step."""

    kinds: Array  # (2,) of the springs
    coefficients: Array  # (2, 8)
    means: tuple[float, float]  # [rad] of equilibrium and preset
    equilibrium: Array  # (2, k) tones
    preset: Array  # (2, k) tones
    fade_in: float  # [s]
    proportional_gain: float
    derivative_gain: float
    velocity_bandwidth: float
    torque_limit: Array  # (2,) [N m]


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
        first, second = state.reference
        return np.array([0.5 * (first + second), 0.5 * (first - second)])

    @cached_property
    def _constants(self) -> _Constants:
        return _Constants(
            np.array([spring.kind for spring in self.springs]),
            np.array([spring.coefficients() for spring in self.springs]),
            (float(self.equilibrium.mean), float(self.preset.mean)),
            self.equilibrium.tones,
            self.preset.tones,
            float(self.fade_in),
            float(self.proportional_gain),
            float(self.derivative_gain),
            float(self.velocity_bandwidth),
            np.array(self.torque_limit, dtype=np.float64),
        )

    def init(self) -> MotorPositionState:
        zeros = locked(np.zeros(2), "theta")
        return MotorPositionState(nan, zeros, 0.0, zeros, zeros, locked(np.full(2, nan), "reference"))

    def references(self, time: float, origin: Array) -> Array:
        """theta_d (2,) [rad] at `time` [s] since the start at the motor angles `origin` (2,) [rad]."""
        return np.asarray(_references(self._constants, float(time), origin))

    def step(self, state: MotorPositionState, sample: JointSample) -> tuple[MotorPositionState, Torques]:
        # The link angle is not used.
        if not (isfinite(sample.time) and all(abs(angle) < LARGEST for angle in sample.theta.tolist())):
            return state, passive(2)
        theta = sample.theta.copy()
        theta.flags.writeable = False
        if isnan(state.start):
            state = MotorPositionState(sample.time, theta, sample.time, theta, state.velocity, state.reference)
        elapsed, step = sample.time - state.start, sample.time - state.time
        out = np.empty((3, 2))
        saturated = _step(self._constants, elapsed, step, state.origin, state.theta, state.velocity, theta, out)
        reference, velocity, torque = out
        out.flags.writeable = reference.flags.writeable = velocity.flags.writeable = False
        after = MotorPositionState(state.start, state.origin, sample.time, theta, velocity, reference)
        return after, Torques(torque, saturated)


@njit(cache=True, error_model="numpy")
def _references(given: _Constants, time: float, origin: Array) -> Array:
    """theta_d (2,) [rad]."""
    x, s = multisine(given.means[0], given.equilibrium, time), multisine(given.means[1], given.preset, time)
    u = min(time / given.fade_in, 1.0)
    fade = u * u * (3.0 - 2.0 * u)
    out = np.empty(2)
    out[0], out[1] = (1.0 - fade) * origin[0] + fade * (x + s), (1.0 - fade) * origin[1] + fade * (x - s)
    return out


@njit(cache=True, error_model="numpy")
def _step(
    given: _Constants, elapsed: float, step: float, origin: Array, before: Array, velocity: Array, theta: Array,
    out: Array,
) -> bool:  # fmt: skip
    """Write references, velocities and limited torques into `out` (3, 2); returns whether a torque was cut.

    `theta` are the motor angles `step` [s] after `before`. Returned arrays would take longer than the computation.
    """
    reference = _references(given, elapsed, origin)
    moving = low_passed(velocity, before, theta, step, given.velocity_bandwidth)
    x = 0.5 * (reference[0] + reference[1])
    torque = np.empty(2)
    for i in range(2):
        tau_0 = -spring_torque(given.kinds[i], given.coefficients[i], x - reference[i], 0.0)
        error = theta[i] - reference[i]
        torque[i] = tau_0 - given.derivative_gain * moving[i] - given.proportional_gain * error
    out[0], out[1] = reference, moving
    out[2], saturated = limited_torque(torque, given.torque_limit)
    return saturated
