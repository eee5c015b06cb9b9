"""Limit cycle of a joint by switching motors: `bang_bang` with one coordinate, eqs. (120)-(122).

    tau_z = sum_i [tau_e,i(q_0 - theta_0,i) - tau_e,i(q - theta_i)]
    theta_d = theta_0 + w theta_hat sign(tau_z)   where |tau_z| > epsilon,   theta_0 elsewhere
    tau = tau_0 - K_D thd - K_P (theta - theta_d),   K_P = B omega_m^2,  K_D = 2 B omega_m

w is constant: it moves the equilibrium and keeps the preset, (1, 1) for an antagonistic joint, (1, 0) for a serial one.
Motor velocities are not measured: they are derivatives of the angles behind a low pass.

A joint at rest stays there. Where |tau_z| <= epsilon for a time T, the motors therefore step by w theta_hat and, after
another T, back, until the link swings.
Source: the document's Section 6.2, after D. Lakatos et al. (its reference [25]); it has no start.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sin
from typing import NamedTuple

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked

from via_controllers.contract import (
    Controller,
    JointSample,
    Quantity,
    Torques,
    limited,
    passive,
    require_not_negative,
    require_positive,
)
from via_controllers.joint_axes import JointAxes
from via_controllers.low_pass import low_passed

WIDEST = 1.0  # [rad] half width of the interval about theta_0 in which the rest angle is searched


@dataclass(frozen=True)
class JointBangBangState:
    """State after a sample; before the first one `theta` is None."""

    time: float  # [s]
    theta: Array | None  # (m,) [rad]
    velocity: Array  # (m,) [rad/s] low-passed
    torque: float  # tau_z [N m]
    switch: int  # -1, 0 or 1
    since: float = 0.0  # [s] of the last sample with |tau_z| > epsilon, or of the first one


class _Motors(NamedTuple):
    """Constants of the m motors."""

    theta_0: Array  # (m,) [rad]
    w: Array  # (m,) [-]
    inertia: Array  # B (m,) [kg m^2]
    limit: Array  # (m,) [N m]
    static: Array  # tau_e at q_0 and theta_0, one entry per spring [N m]


@dataclass(frozen=True, eq=False)
class JointBangBang(Controller[JointBangBangState]):
    """Bang-bang control of a device with torque motors. Raises ParameterError for values outside the stated ranges."""

    device: Device
    equilibrium: float  # [rad] of theta_0
    preset: float  # [rad] of theta_0
    amplitude: float  # theta_hat >= 0 [rad]
    threshold: float  # epsilon >= 0 [N m]
    bandwidth: float  # omega_m > 0 [rad/s]
    velocity_bandwidth: float  # > 0 [rad/s]
    start: float = 0.0  # T >= 0 [s]; 0: the joint waits for a push
    _motors: _Motors = field(init=False, repr=False)

    def __post_init__(self) -> None:
        axes = JointAxes(self.device)
        require_not_negative(self, "amplitude", "threshold", "start")
        require_positive(self, "bandwidth", "velocity_bandwidth")
        theta_0 = self.device.motor_angles(self.equilibrium, self.preset)
        q_0 = hanging(self.device, theta_0, self.equilibrium)
        w, static = self.device.motor_angles(1.0, 0.0), self.device.torque_each(q_0, theta_0)
        motors = _Motors(theta_0, w, axes.motor_inertia, axes.torque_limit, static)
        object.__setattr__(self, "_motors", motors)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("tau_z", "N m"), Quantity("switch", "-")

    def observe(self, state: JointBangBangState) -> Array:
        return np.array([state.torque, state.switch])

    def init(self) -> JointBangBangState:
        return JointBangBangState(0.0, None, np.zeros(self.device.n_motors), 0.0, 0)

    def step(self, state: JointBangBangState, sample: JointSample) -> tuple[JointBangBangState, Torques]:
        if not sample.valid:
            return state, passive(self.device.n_motors)
        before = sample.theta if state.theta is None else state.theta
        step = 0.0 if state.theta is None else sample.time - state.time
        velocity = low_passed(state.velocity, before, sample.theta, step, self.velocity_bandwidth)
        torque = float((self._motors.static - self.device.torque_each(sample.q, sample.theta)).sum())
        swings = abs(torque) > self.threshold
        since = state.since if step > 0.0 and not swings else sample.time
        rests = int((sample.time - since) / self.start) if self.start > 0.0 else 0  # times T
        switch = int(np.sign(torque)) if swings else rests % 2
        theta, velocity = locked(sample.theta, "theta"), locked(velocity, "velocity")
        after = JointBangBangState(sample.time, theta, velocity, torque, switch, since)
        return after, self._torques(sample.theta, velocity, switch)

    def _torques(self, theta: Array, velocity: Array, switch: int) -> Torques:
        motors = self._motors
        theta_d = motors.theta_0 + self.amplitude * switch * motors.w
        feedback = self.bandwidth * (theta - theta_d) + 2.0 * velocity
        load = np.zeros(len(motors.inertia))
        load[: len(motors.static)] = -motors.static  # device files have no load of a preset motor
        return limited(load - self.bandwidth * motors.inertia * feedback, motors.limit)


def hanging(device: Device, theta: Array, near: float) -> float:
    """Link angle [rad] at rest with the motors at `theta` (m,) [rad], within a radian of `near`.

    Raises ParameterError if there is none.
    """

    from scipy.optimize import brentq  # slow to import, only needed here

    def force(q: float) -> float:
        gravity = device.link.gravity_torque * sin(q - device.link.gravity_angle)
        return gravity + float(device.torque_each(q, theta).sum())

    reach = min(WIDEST, *(spring.max_deflection - abs(near - t) for spring, t in zip(device.springs, theta)))
    if not (reach > 0.0 and force(near - reach) < 0.0 < force(near + reach)):
        raise ParameterError(f"device: no rest of '{device.name}' near {near} rad with its motors at {theta} rad")
    return float(brentq(force, near - reach, near + reach, xtol=1e-14))
