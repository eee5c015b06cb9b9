"""A flexible arm in motion: classical Runge-Kutta steps of its links and motors under held torques, limits applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm


@dataclass(frozen=True)
class ArmState:
    """Angles [rad] and velocities [rad/s] of links and motors, (n,) each."""

    q: Array
    velocity: Array
    theta: Array
    motor_velocity: Array


def loaded_state(arm: VsaArm, q: Array, velocity: Array, spring_torque: Array, spring_rate: Array) -> ArmState:
    """The state in which the springs give tau_e `spring_torque` [N m], changing at `spring_rate` [N m/s], (n,) each."""
    phi = arm.deflection(spring_torque)
    _, stiffness, _ = arm.spring_state(phi)
    return ArmState(q, velocity, q - phi, velocity - spring_rate / stiffness)


def arm_step(arm: VsaArm, state: ArmState, torque: Array, external: Array, step: float, substeps: int = 4) -> ArmState:
    """The state `step` [s] later under held motor torques and torques on the links, (n,) each [N m].

    A motor gives no more than its torque limit, and nothing that drives it beyond its speed limit.
    Raises ParameterError where a spring is deflected beyond its stop.
    """
    n, h = arm.n, step / substeps
    given = np.clip(torque, -arm.torque_limit, arm.torque_limit)

    def rate(x: Array) -> Array:
        q, v, theta, w = x[:n], x[n : 2 * n], x[2 * n : 3 * n], x[3 * n :]
        held = np.where((np.abs(w) >= arm.speed_limit) & (given * w > 0.0), 0.0, given)
        return np.concatenate([v, *_accelerated(arm, q, v, theta, w, held, external)])

    x = np.concatenate([state.q, state.velocity, state.theta, state.motor_velocity])
    for _ in range(substeps):
        k1 = rate(x)
        k2 = rate(x + 0.5 * h * k1)
        k3 = rate(x + 0.5 * h * k2)
        k4 = rate(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    q, v, theta, w = x.reshape(4, n)
    stops = np.array([law.max_deflection for law in arm.springs])
    if not (np.abs(q - theta) <= stops).all():
        raise ParameterError(f"springs reach their stops: deflections {q - theta} rad")
    return ArmState(q, v, theta, w)


def _accelerated(
    arm: VsaArm, q: Array, v: Array, theta: Array, w: Array, torque: Array, external: Array
) -> tuple[Array, Array, Array]:
    links, motors = arm.accelerations(q, v, theta, w, torque, external)
    return links, w, motors
