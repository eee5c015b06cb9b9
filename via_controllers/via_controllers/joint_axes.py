"""A joint represented as an arm: one axis per motor, each with the same link.

    q -> (q, .., q),   theta -> (theta_1, .., theta_m),   M qdd = -sum_i tau_e,i - Dq qd - g(q)

With it the limits, holding controllers and supervision of arms also work for joints. The preset motor of a serial joint
is an axis without a spring: device files have no load of the preset. A transmission's damper acts beside spring 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, sin
from typing import Generic, NamedTuple

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array, locked
from via_core.spring_equations import spring_stiffness, spring_torque

from via_controllers.contract import (
    ArmController,
    ArmSample,
    Controller,
    JointSample,
    Quantity,
    State,
    Torques,
    passive,
    require,
)


class _Springs(NamedTuple):
    """The k springs of a joint."""

    kinds: Array  # (k,)
    coefficients: Array  # (k, 8)
    serial: bool  # whether motor 2 is the preset of spring 1
    stops: Array  # (m,) [rad] largest deflections


class _Link(NamedTuple):
    """The link of a joint, with the damper."""

    inertia: float  # M [kg m^2]
    friction: float  # Dq [N m s/rad], including a damper on the link
    gravity: float  # [N m]
    gravity_angle: float  # [rad]
    damping: float  # [N m s/rad] of a damper on transmission 1


@dataclass(frozen=True, eq=False)
class JointAxes:
    """The m axes of a device. Raises ParameterError for a device without springs or without torque motors."""

    device: Device
    damping: float = 0.0  # damper command [0..1]
    motor_inertia: Array = field(init=False, repr=False)  # B (m,) [kg m^2]
    motor_friction: Array = field(init=False, repr=False)  # D (m,) [N m s/rad]
    torque_limit: Array = field(init=False, repr=False)  # (m,) [N m], infinite without a limit, like the next two
    speed_limit: Array = field(init=False, repr=False)  # (m,) [rad/s]
    deflection_limit: Array = field(init=False, repr=False)  # (m,) [rad]
    _springs: _Springs = field(init=False, repr=False)
    _link: _Link = field(init=False, repr=False)

    def __post_init__(self) -> None:
        device = self.device
        require(bool(device.springs), f"device: '{device.name}' has no springs")
        require(device.drive == "torque", f"device: the motors of '{device.name}' take no torques")
        motors, springs = device.torque_motors, device.springs
        derived = {
            "motor_inertia": [motor.inertia for motor in motors],
            "motor_friction": [motor.viscous_friction for motor in motors],
            "torque_limit": [motor.torque_limit or inf for motor in motors],
            "speed_limit": [motor.speed_limit or inf for motor in motors],
            "deflection_limit": [each.max_deflection for each in springs] + [inf] * (len(motors) - len(springs)),
        }
        for name, values in derived.items():
            object.__setattr__(self, name, locked(np.array(values), name))
        kinds, coefficients = (np.array(each) for each in zip(*((s.kind, s.coefficients()) for s in springs)))
        serial = device.arrangement == "serial"
        object.__setattr__(self, "_springs", _Springs(kinds, coefficients, serial, self.deflection_limit))
        object.__setattr__(self, "_link", self._link_with_damper())

    def _link_with_damper(self) -> _Link:
        device, link = self.device, self.device.link
        damping = float(device.damping_of(self.damping))
        across = device.damper is not None and device.damper.site == "transmission"
        friction = link.viscous_friction + (0.0 if across else damping)
        return _Link(link.inertia, friction, link.gravity_torque, link.gravity_angle, damping if across else 0.0)

    @property
    def n(self) -> int:
        """Number of axes."""
        return self.device.n_motors

    def spring_torque(self, q: float, theta: Array) -> Array:
        """tau_e (m,) [N m] at `q` [rad] and `theta` (m,) [rad]; constant beyond a stop, 0 without a spring."""
        return np.asarray(_spring_state(self._springs, q, theta)[0])

    def spring_stiffness(self, q: float, theta: Array) -> Array:
        """sigma (m,) [N m/rad], as `spring_torque`."""
        return np.asarray(_spring_state(self._springs, q, theta)[1])

    def loads(self, q: Array, velocity: Array, theta: Array, motor_velocity: Array) -> tuple[Array, Array]:
        """tau_e [N m], damper included, and the resulting qdd [rad/s^2], (m,) each."""
        out = np.empty((2, len(theta)))
        _loads(self._springs, self._link, q, velocity, theta, motor_velocity, out)
        return out[0], out[1]


@njit(cache=True, error_model="numpy")
def _spring_state(springs: _Springs, q: float, theta: Array) -> Array:
    """tau_e and sigma (2, m) as `Device.torque_each` and `stiffness_each`, deflections clipped to the stops."""
    out = np.zeros((2, theta.size))
    for i in range(springs.kinds.size):
        phi = min(max(q - theta[i], -springs.stops[i]), springs.stops[i])
        own = theta[1] if springs.serial else q - phi
        out[0, i] = spring_torque(springs.kinds[i], springs.coefficients[i], phi, own)
        out[1, i] = spring_stiffness(springs.kinds[i], springs.coefficients[i], phi, own)
    return out


@njit(cache=True, error_model="numpy")
def _loads(
    springs: _Springs, link: _Link, q: Array, velocity: Array, theta: Array, motor_velocity: Array, out: Array
) -> None:
    """Write `JointAxes.loads` into `out` (2, m): returned arrays take longer than the computation."""
    torque = out[0]
    torque[:] = _spring_state(springs, q[0], theta)[0]
    torque[0] += link.damping * (velocity[0] - motor_velocity[0])
    gravity = link.gravity * sin(q[0] - link.gravity_angle)
    out[1] = (-torque.sum() - link.friction * velocity[0] - gravity) / link.inertia


@dataclass(frozen=True, eq=False)
class OnAxes(ArmController[State], Generic[State]):
    """A joint's controller applied to its axes.

    initial  returns the initial state; None: the controller's `init`
    """

    controller: Controller[State]
    initial: Callable[[], State] | None = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return self.controller.quantities

    def observe(self, state: State) -> Array:
        return self.controller.observe(state)

    def init(self, sample: ArmSample) -> State:
        return self.controller.init() if self.initial is None else self.initial()

    def step(self, state: State, sample: ArmSample) -> tuple[State, Torques]:
        if not sample.valid:
            return state, passive(len(sample.theta))
        return self.controller.step(state, JointSample(sample.time, float(sample.q[0]), sample.theta))
