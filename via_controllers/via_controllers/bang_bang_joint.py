"""A limit cycle of one joint by motors that switch: `bang_bang` with a single coordinate, eqs. (120)-(122).

    tau_z = sum_i [tau_e,i(q_0 - theta_0,i) - tau_e,i(q - theta_i)]
    theta_d = theta_0 + w theta_hat sign(tau_z)   where |tau_z| > epsilon,   theta_0 elsewhere
    tau = tau_0 - K_D thd - K_P (theta - theta_d),   K_P = B omega_m^2,  K_D = 2 B omega_m

Nothing is to be learned: w moves the equilibrium and leaves the preset, (1, 1) of an antagonistic joint, (1, 0) of a
serial one. Motor velocities are not measured: angles' derivatives behind a low pass.
Source: the document's Section 6.2, after D. Lakatos et al. (its reference [25]).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, sin

import numpy as np
from scipy.optimize import brentq
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, locked

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, require
from via_controllers.low_pass import low_passed

WIDEST = 1.0  # [rad] to either side of theta_0, within which the link is looked for at rest


@dataclass(frozen=True)
class JointBangBangState:
    """Where the law stands after a sample; before the first one `theta` is None."""

    time: float  # [s]
    theta: Array | None  # (m,) [rad]
    velocity: Array  # (m,) [rad/s] low-passed
    torque: float  # tau_z [N m]
    switch: int  # -1, 0 or 1


@dataclass(frozen=True, eq=False)
class JointBangBang(Controller[JointBangBangState]):
    """The law of this file for a device with torque motors. Raises ParameterError for what is not said here."""

    device: Device
    equilibrium: float  # [rad] of theta_0
    preset: float  # [rad] of theta_0
    amplitude: float  # theta_hat >= 0 [rad]
    threshold: float  # epsilon >= 0 [N m]
    bandwidth: float  # omega_m > 0 [rad/s]
    velocity_bandwidth: float  # > 0 [rad/s]

    def __post_init__(self) -> None:
        name = self.device.name
        require(bool(self.device.springs), f"device: '{name}' has no springs")
        require(self.device.drive == "torque", f"device: the motors of '{name}' take no torques")
        for each in ("amplitude", "threshold"):
            value = getattr(self, each)
            require(isfinite(value) and value >= 0.0, f"{each} must be >= 0, got {value}")
        for each in ("bandwidth", "velocity_bandwidth"):
            value = getattr(self, each)
            require(isfinite(value) and value > 0.0, f"{each} must be > 0, got {value}")
        motors = [motor for motor in self.device.motors if isinstance(motor, TorqueMotor)]
        theta_0 = self.device.motor_angles(self.equilibrium, self.preset)
        q_0 = hanging(self.device, theta_0, self.equilibrium)
        known = {
            "_theta_0": theta_0,
            "_w": self.device.motor_angles(1.0, 0.0),
            "_inertia": np.array([motor.inertia for motor in motors]),
            "_limit": np.array([inf if motor.torque_limit is None else motor.torque_limit for motor in motors]),
            "_static": self.device.torque_each(q_0, theta_0),
        }
        for each, values in known.items():
            object.__setattr__(self, each, locked(values, each))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("tau_z", "N m"), Quantity("switch", "-")

    def told(self, state: JointBangBangState) -> Array:
        return np.array([state.torque, state.switch])

    def init(self) -> JointBangBangState:
        return JointBangBangState(0.0, None, np.zeros(self.device.n_motors), 0.0, 0)

    def step(self, state: JointBangBangState, sample: JointSample) -> tuple[JointBangBangState, Torques]:
        if not (isfinite(sample.time) and isfinite(sample.q) and np.isfinite(sample.theta).all()):
            return state, Torques(np.zeros(self.device.n_motors), False)  # blind: passive
        before = sample.theta if state.theta is None else state.theta
        step = 0.0 if state.theta is None else sample.time - state.time
        velocity = low_passed(state.velocity, before, sample.theta, step, self.velocity_bandwidth)
        static: Array = self._static  # type: ignore[attr-defined]
        torque = float((static - self.device.torque_each(sample.q, sample.theta)).sum())
        switch = int(np.sign(torque)) if abs(torque) > self.threshold else 0
        after = JointBangBangState(
            sample.time, locked(sample.theta, "theta"), locked(velocity, "velocity"), torque, switch
        )
        return after, self._torques(sample.theta, velocity, switch)

    def _torques(self, theta: Array, velocity: Array, switch: int) -> Torques:
        B, limit, static = self._inertia, self._limit, self._static  # type: ignore[attr-defined]
        wanted = self._theta_0 + self.amplitude * switch * self._w  # type: ignore[attr-defined]
        pull = self.bandwidth * (theta - wanted) + 2.0 * velocity
        load = np.zeros(len(B))
        load[: len(static)] = -static  # a preset motor carries nothing that the device file knows
        return limited(load - self.bandwidth * B * pull, limit)


def hanging(device: Device, theta: Array, near: float) -> float:
    """Link angle [rad] at rest with the motors at `theta` (m,) [rad], within a radian of `near`.

    Raises ParameterError where there is none.
    """

    def force(q: float) -> float:
        gravity = device.link.gravity_torque * sin(q - device.link.gravity_angle)
        return gravity + float(device.torque_each(q, theta).sum())

    reach = min(WIDEST, *(law.max_deflection - abs(near - t) for law, t in zip(device.spring_laws, theta)))
    if not (reach > 0.0 and force(near - reach) < 0.0 < force(near + reach)):
        raise ParameterError(f"device: no rest of '{device.name}' near {near} rad with its motors at {theta} rad")
    return float(brentq(force, near - reach, near + reach, xtol=1e-14))
