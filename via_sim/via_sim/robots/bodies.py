"""Common simulation interface for multi-joint robots: step, push, hold, release."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

from via_core.signals import Array


@dataclass(frozen=True)
class ArmState:
    """Angles [rad] and velocities [rad/s] of links and motors, (n,) each."""

    q: Array
    velocity: Array
    theta: Array
    motor_velocity: Array


State = TypeVar("State", bound=ArmState)


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
    def spring_torque(self, state: State) -> Array:
        """tau_e (n,) [N m]."""

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
