"""Common simulation interface for multi-joint robots: step, measure, push, hold, release.

Body     the interface, used by the simulator nodes
ArmBody  an arm of flexible joints with walls around it
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Generic, Self, TypeVar

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

from via_sim.robots.arm import ArmState, arm_step, contact_force, limited_torque
from via_sim.robots.contacts import Contact, Hand

State = TypeVar("State")


@dataclass(frozen=True)
class BodyMeasurement:
    """Measurements of ideal sensors on a robot with n joints, (n,) each."""

    q: Array  # [rad] links
    velocity: Array  # [rad/s]
    theta: Array  # [rad] motors
    motor_velocity: Array  # [rad/s]
    spring_torque: Array  # [N m] tau_e


class Body(ABC, Generic[State]):
    """A robot of n flexible joints: parameters are fields, methods return new states."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the robot, as in its topics."""

    @property
    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints, base first."""

    @abstractmethod
    def init(self) -> State:
        """Initial state, at rest."""

    @abstractmethod
    def step(self, state: State, torque: Array, period: float) -> State:
        """State `period` [s] later under constant motor torques (n,) [N m].

        Raises ParameterError where a spring is deflected beyond its stop.
        """

    @abstractmethod
    def limited(self, state: State, torque: Array) -> Array:
        """Motor torque (n,) [N m] under the command `torque` (n,) [N m]."""

    @abstractmethod
    def stopped(self, state: State) -> State:
        """The state with all velocities zero."""

    @abstractmethod
    def measure(self, state: State) -> BodyMeasurement:
        """Measurements of ideal sensors."""

    @abstractmethod
    def contact_force(self, state: State) -> Array:
        """Force (3,) [N] of walls, hands and ground on the robot."""

    @abstractmethod
    def base(self, state: State) -> Array | None:
        """Pose (7,) of the base: x, y, z [m], quaternion x, y, z, w; None for a fixed base."""

    @abstractmethod
    def pushed(self, state: State, impulse: Array, deflection: Array) -> State:
        """State after an `impulse` (n,) [N m s] on the links, which are displaced by `deflection` (n,) [rad].

        Raises ParameterError where a spring would be beyond its stop, or where the robot cannot be pushed.
        """

    @abstractmethod
    def held(self, state: State) -> Self:
        """The robot with its end effector held at its place; raises ParameterError for a robot without one."""

    @abstractmethod
    def released(self) -> Self:
        """The robot with its end effector released."""


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

    def measure(self, state: ArmState) -> BodyMeasurement:
        spring_torque, _, _ = self.arm.spring_state(state.q - state.theta)
        return BodyMeasurement(state.q, state.velocity, state.theta, state.motor_velocity, spring_torque)

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
