"""A joint seen as an arm: one axis per motor, behind each of them the same link.

    q -> (q, .., q),   theta -> (theta_1, .., theta_m),   M qdd = -sum_i tau_e,i - Dq qd - g(q)

What keeps limits, holds still and decides for arms then serves joints as well. The preset motor of a serial joint is an
axis without a spring: what the preset costs no device file tells. A transmission's damper stands beside spring 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, sin
from typing import Generic

import numpy as np
from numba import njit
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.signals import Array, locked
from via_core.springs import spring_stiffness, spring_torque

from via_controllers.contract import (
    ArmController,
    ArmSample,
    Controller,
    JointSample,
    Quantity,
    State,
    Torques,
    blind,
    require,
)


@dataclass(frozen=True, eq=False)
class JointAxes:
    """The m axes of a device. Raises ParameterError for one without springs or without motors that take torques."""

    device: Device
    damping: float = 0.0  # command of the damper [0..1]
    motor_inertia: Array = field(init=False, repr=False)  # B (m,) [kg m^2]
    motor_friction: Array = field(init=False, repr=False)  # D (m,) [N m s/rad]
    torque_limit: Array = field(
        init=False, repr=False
    )  # (m,) [N m], infinite where there is none, as those that follow
    speed_limit: Array = field(init=False, repr=False)  # (m,) [rad/s]
    deflection_limit: Array = field(init=False, repr=False)  # (m,) [rad]
    _springs: tuple[Array, Array, bool] = field(init=False, repr=False)  # kinds, coefficients, whether serial

    def __post_init__(self) -> None:
        device = self.device
        require(bool(device.springs), f"device: '{device.name}' has no springs")
        require(device.drive == "torque", f"device: the motors of '{device.name}' take no torques")
        motors = [motor for motor in device.motors if isinstance(motor, TorqueMotor)]
        stops = [law.max_deflection for law in device.spring_laws]
        known = {
            "motor_inertia": [motor.inertia for motor in motors],
            "motor_friction": [motor.viscous_friction for motor in motors],
            "torque_limit": [motor.torque_limit or inf for motor in motors],
            "speed_limit": [motor.speed_limit or inf for motor in motors],
            "deflection_limit": [*stops, *[inf] * (len(motors) - len(stops))],
        }
        for name, values in known.items():
            object.__setattr__(self, name, locked(np.array(values), name))
        laws = device.spring_laws
        compiled = np.array([law.kind for law in laws]), np.array([law.coefficients() for law in laws])
        object.__setattr__(self, "_springs", (*compiled, device.arrangement == "serial"))

    @property
    def n(self) -> int:
        """Number of axes."""
        return self.device.n_motors

    def spring_torque(self, q: float, theta: Array) -> Array:
        """tau_e (m,) [N m] at `q` [rad] and `theta` (m,) [rad]; beyond a stop that of the stop, without a spring 0."""
        return np.asarray(_springs(*self._springs, q, theta, self.deflection_limit)[0])

    def spring_stiffness(self, q: float, theta: Array) -> Array:
        """sigma (m,) [N m/rad], as `spring_torque`."""
        return np.asarray(_springs(*self._springs, q, theta, self.deflection_limit)[1])

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """tau_e [N m], damper included, and qdd [rad/s^2] under it, (m,) each."""
        device, link = self.device, self.device.link
        torque, friction = self.spring_torque(q[0], theta), link.viscous_friction
        if device.damper is not None:
            damping = float(device.damping_of(self.damping))
            if device.damper.site == "transmission":
                torque[0] += damping * (velocity[0] - motor_velocity[0])
            else:
                friction += damping
        gravity = link.gravity_torque * sin(q[0] - link.gravity_angle)
        return torque, np.full(self.n, (-torque.sum() - friction * velocity[0] - gravity) / link.inertia)


@njit(cache=True, error_model="numpy")
def _springs(kinds: Array, rows: Array, serial: bool, q: float, theta: Array, stops: Array) -> Array:
    """tau_e and sigma (2, m): what `Device.torque_each` and `stiffness_each` say, within the stops."""
    out = np.zeros((2, theta.size))
    for i in range(kinds.size):
        phi = min(max(q - theta[i], -stops[i]), stops[i])
        own = theta[1] if serial else q - phi
        out[0, i] = spring_torque(kinds[i], rows[i], phi, own)
        out[1, i] = spring_stiffness(kinds[i], rows[i], phi, own)
    return out


@dataclass(frozen=True, eq=False)
class OnAxes(ArmController[State], Generic[State]):
    """A joint's law as one of its axes.

    begin  where the law starts from, if not from its `init`
    """

    law: Controller[State]
    begin: Callable[[], State] | None = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return self.law.quantities

    def told(self, state: State) -> Array:
        return self.law.told(state)

    def init(self, sample: ArmSample) -> State:
        return self.law.init() if self.begin is None else self.begin()

    def step(self, state: State, sample: ArmSample) -> tuple[State, Torques]:
        if blind(sample):
            return state, Torques(np.zeros(len(sample.theta)), False)
        return self.law.step(state, JointSample(sample.time, float(sample.q[0]), sample.theta))
