"""Motion of an arm with flexible joints: Runge-Kutta steps under constant motor torques, with limits and contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numba import njit
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_sim.robots.bodies import ArmState, Body
from via_sim.robots.contacts import Contact, Hand


def arm_step(
    arm: VsaArm,
    state: ArmState,
    torque: Array,
    step: float,
    substeps: int = 4,
    contacts: Sequence[Contact] = (),
) -> ArmState:
    """State `step` [s] later under constant motor torques (n,) [N m], limited as in `limited_torque`.

    `contacts` act on the tip; a wall of 5e4 N/m needs substeps of 0.25 ms or less.
    Raises ParameterError where a spring is deflected beyond its stop.
    """
    h, no_load = step / substeps, np.zeros(arm.n)

    def rate(x: Array, motor_torque: Array) -> Array:
        return arm.rates(x, motor_torque, contact_torque(arm, x[0], x[1], contacts) if contacts else no_load)

    x = np.array([state.q, state.velocity, state.theta, state.motor_velocity])
    for _ in range(substeps):
        limited = limited_torque(arm, x[3], torque)
        k1 = rate(x, limited)
        k2 = rate(x + 0.5 * h * k1, limited)
        k3 = rate(x + 0.5 * h * k2, limited)
        k4 = rate(x + h * k3, limited)
        _add(x, h, k1, k2, k3, k4)
    q, v, theta, w = x
    if not (np.abs(q - theta) <= arm.deflection_limit).all():
        raise ParameterError(f"springs reach their stops: deflections {q - theta} rad")
    return ArmState(q, v, theta, w)


@njit(cache=True, error_model="numpy")
def _add(x: Array, h: float, k1: Array, k2: Array, k3: Array, k4: Array) -> None:
    """Add the increment of a Runge-Kutta step to a state (4, n)."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] += h / 6.0 * (k1[i, j] + 2.0 * (k2[i, j] + k3[i, j]) + k4[i, j])


def limited_torque(arm: VsaArm, motor_velocity: Array, torque: Array) -> Array:
    """Torque (n,) [N m] of motors at `motor_velocity` (n,) [rad/s] under the command `torque` (n,) [N m].

    It stays within the torque limit, and is zero where it would drive a motor beyond its speed limit.
    """
    return np.asarray(_limited(torque, motor_velocity, arm.torque_limit, arm.speed_limit))


@njit(cache=True, error_model="numpy")
def _limited(torque: Array, speed: Array, torque_limit: Array, speed_limit: Array) -> Array:
    out = np.empty(torque.size)
    for i in range(torque.size):
        out[i] = min(max(torque[i], -torque_limit[i]), torque_limit[i])
        if abs(speed[i]) >= speed_limit[i] and out[i] * speed[i] > 0.0:
            out[i] = 0.0
    return out


def contact_force(arm: VsaArm, q: Array, velocity: Array, contacts: Sequence[Contact]) -> Array:
    """Force (3,) [N] of `contacts` on the tip at `q` (n,) [rad] and `velocity` (n,) [rad/s]."""
    position = arm.tip_position(q)
    touching = [contact for contact in contacts if contact.touches(position)]
    if not touching:
        return np.zeros(3)
    moving = arm.tip_jacobian(q) @ velocity
    return np.sum([contact.force(position, moving) for contact in touching], axis=0)


def contact_torque(arm: VsaArm, q: Array, velocity: Array, contacts: Sequence[Contact]) -> Array:
    """Torque (n,) [N m] of `contacts` on the links."""
    force = contact_force(arm, q, velocity, contacts)
    return np.asarray(arm.tip_jacobian(q).T @ force) if force.any() else np.zeros(arm.n)


@dataclass(frozen=True, eq=False)
class ArmBody(Body[ArmState]):
    """An arm with walls. Raises ParameterError for a posture that its springs cannot hold."""

    arm: VsaArm
    posture: Array  # (n,) [rad] initial link angles
    walls: tuple[Contact, ...] = ()
    hand: Hand | None = None
    substeps: int = 2  # per step; twice as many with walls or a hand

    def __post_init__(self) -> None:
        if self.posture.shape != (self.arm.n,) or not np.isfinite(self.posture).all():
            raise ParameterError(f"posture must hold {self.arm.n} angles, got {self.posture}")
        self.init()

    @property
    def name(self) -> str:
        return self.arm.name

    @property
    def joints(self) -> tuple[str, ...]:
        return self.arm.joints

    @property
    def _contacts(self) -> tuple[Contact, ...]:
        return self.walls if self.hand is None else (*self.walls, self.hand)

    def init(self) -> ArmState:
        zero = np.zeros(self.arm.n)
        return ArmState(self.posture, zero, self.arm.rest(self.posture), zero)

    def step(self, state: ArmState, torque: Array, period: float) -> ArmState:
        contacts = self._contacts
        substeps = 2 * self.substeps if contacts else self.substeps
        return arm_step(self.arm, state, torque, period, substeps, contacts)

    def limited(self, state: ArmState, torque: Array) -> Array:
        return limited_torque(self.arm, state.motor_velocity, torque)

    def stopped(self, state: ArmState) -> ArmState:
        zero = np.zeros(self.arm.n)
        return ArmState(state.q, zero, state.theta, zero)

    def spring_torque(self, state: ArmState) -> Array:
        return self.arm.spring_state(state.q - state.theta)[0]

    def contact_force(self, state: ArmState) -> Array:
        return contact_force(self.arm, state.q, state.velocity, self._contacts)

    def base(self, state: ArmState) -> Array | None:
        return None

    def pushed(self, state: ArmState, impulse: Array, deflection: Array) -> ArmState:
        step = np.linalg.solve(self.arm.inertia(state.q), impulse)
        after = replace(state, q=state.q + deflection, velocity=state.velocity + step)
        beyond = np.abs(after.q - after.theta) > self.arm.deflection_limit
        if beyond.any():
            raise ParameterError(f"springs would be beyond their stops: deflections {after.q - after.theta} rad")
        return after

    def held(self, state: ArmState) -> Self:
        return replace(self, hand=Hand(self.arm.tip_position(state.q)))

    def released(self) -> Self:
        return replace(self, hand=None)
