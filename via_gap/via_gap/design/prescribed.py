"""Motion of a joint whose motors follow given angles: the link is simulated, the torques follow from the equations.

    M qdd = -Dq qd - Fq sgn qd - sum_i tau_e,i(q - theta_i) - damper - G sin(q - q_0)        (Runge-Kutta, order 4)
    tau_i = B thdd + Dth thd + F sgn thd - tau_e,i - damper

Nothing is controlled, so that a candidate of a search costs milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.signals import Array
from via_core.spring_equations import spring_torque

SHARP = 0.01  # [rad/s] below which dry friction is linear in the speed


@dataclass(frozen=True, eq=False)
class Prescribed:
    """Motion at `time` (N,) [s]: q (N,), theta and theta_velocity (N, m), torque (N, m) of the motors [N m]."""

    time: Array
    q: Array
    theta: Array
    theta_velocity: Array
    torque: Array

    def every(self, step: int) -> Prescribed:
        """Every `step`-th sample."""
        return Prescribed(*(each[::step] for each in vars(self).values()))


def prescribed(device: Device, time: Array, theta: Array) -> Prescribed:
    """The motion with motor angles theta (N, m) [rad] at equidistant times (N,), the link at rest at q = 0 first."""
    springs, link, n = device.springs, device.link, device.n_transmissions
    damping = float(device.damping_of(0.0)) if device.damper is not None else 0.0
    across = damping if device.damper is not None and device.damper.site == "transmission" else 0.0
    viscous = link.viscous_friction + (damping - across)
    velocity = np.gradient(theta, time, axis=0)
    kinds, rows = np.array([each.kind for each in springs]), np.array([each.coefficients() for each in springs])
    numbers = np.array(
        [link.inertia, viscous, link.coulomb_friction, link.gravity_torque, link.gravity_angle, across],
        dtype=np.float64,
    )
    q, speed = _follow(
        numbers, kinds, rows, np.ascontiguousarray(theta), np.ascontiguousarray(velocity), time[1] - time[0]
    )
    tau_e = np.zeros_like(theta)
    tau_e[:, :n] = device.torque_each(q, theta)
    tau_e[:, 0] += across * (speed - velocity[:, 0])
    motors = device.torque_motors
    inertia, friction, dry = (
        np.array([getattr(motor, name) for motor in motors])
        for name in ("inertia", "viscous_friction", "coulomb_friction")
    )
    own = friction * velocity + dry * np.clip(velocity / SHARP, -1.0, 1.0)
    return Prescribed(time, q, theta, velocity, inertia * np.gradient(velocity, time, axis=0) + own - tau_e)


@njit(cache=True, error_model="numpy")
def _acceleration(
    numbers: Array, kinds: Array, rows: Array, q: float, speed: float, theta: Array, velocity: Array
) -> float:  # fmt: skip
    inertia, viscous, dry, gravity, angle, across = numbers
    torque = viscous * speed + dry * min(max(speed / SHARP, -1.0), 1.0) + gravity * sin(q - angle)
    torque += across * (speed - velocity[0])
    for i in range(kinds.size):
        torque += spring_torque(kinds[i], rows[i], q - theta[i], theta[i])
    return -torque / inertia


@njit(cache=True, error_model="numpy")
def _follow(
    numbers: Array, kinds: Array, rows: Array, theta: Array, velocity: Array, step: float
) -> tuple[Array, Array]:  # fmt: skip
    """Link angle and speed (N,) by four Runge-Kutta steps per sample, motor angles interpolated."""
    n, motors, substeps = theta.shape[0], theta.shape[1], 4
    first, middle, last = np.empty(motors), np.empty(motors), np.empty(motors)
    q, speed = np.zeros(n), np.zeros(n)
    h = step / substeps
    for k in range(1, n):
        x, v = q[k - 1], speed[k - 1]
        for part in range(substeps):
            a, b, c = part / substeps, (part + 0.5) / substeps, (part + 1.0) / substeps
            for i in range(motors):
                change = theta[k, i] - theta[k - 1, i]
                first[i], middle[i], last[i] = (
                    theta[k - 1, i] + a * change, theta[k - 1, i] + b * change, theta[k - 1, i] + c * change,
                )  # fmt: skip
            rate = velocity[k - 1]
            a1 = _acceleration(numbers, kinds, rows, x, v, first, rate)
            a2 = _acceleration(numbers, kinds, rows, x + 0.5 * h * v, v + 0.5 * h * a1, middle, rate)
            a3 = _acceleration(
                numbers, kinds, rows, x + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, middle, rate
            )
            a4 = _acceleration(numbers, kinds, rows, x + h * v + 0.5 * h * h * a2, v + h * a3, last, rate)
            x += h * v + h * h / 6.0 * (a1 + a2 + a3)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        q[k], speed[k] = x, v
    return q, speed
