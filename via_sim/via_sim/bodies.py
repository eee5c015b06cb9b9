"""Whole robots to simulate behind one face, so that one node serves them all: they step, tell, are pushed and held.

Body     what the node asks for
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

from via_sim.arm import ArmState, arm_step, contact_force, given_torque
from via_sim.contacts import Contact, Hand

State = TypeVar("State")


@dataclass(frozen=True)
class BodyReading:
    """What ideal sensors say of a robot with n joints, (n,) each."""

    q: Array  # [rad] links
    velocity: Array  # [rad/s]
    theta: Array  # [rad] motors
    motor_velocity: Array  # [rad/s]
    spring_torque: Array  # [N m] tau_e


class Body(ABC, Generic[State]):
    """A robot of n flexible joints; its parameters are its fields, its state stays as it was."""

    @property
    @abstractmethod
    def name(self) -> str:
        """As in topics."""

    @property
    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints, base first."""

    @abstractmethod
    def init(self) -> State:
        """At rest."""

    @abstractmethod
    def step(self, state: State, torque: Array, period: float) -> State:
        """The state `period` [s] later under held motor torques (n,) [N m].

        Raises ParameterError where a spring would go beyond its stop.
        """

    @abstractmethod
    def given(self, state: State, torque: Array) -> Array:
        """What the motors give (n,) [N m] when asked for `torque` (n,) [N m]."""

    @abstractmethod
    def stopped(self, state: State) -> State:
        """Everything where it is, without velocity."""

    @abstractmethod
    def reading(self, state: State) -> BodyReading:
        """What sensors say."""

    @abstractmethod
    def contact_force(self, state: State) -> Array:
        """What walls, hands and ground do to the robot (3,) [N]."""

    @abstractmethod
    def base(self, state: State) -> Array | None:
        """Pose (7,) of its base: x, y, z [m], quaternion x, y, z, w; None for one that is bolted down."""

    @abstractmethod
    def pushed(self, state: State, impulse: Array, deflection: Array) -> State:
        """After a blow (n,) [N m s] on the links and with links put aside by `deflection` (n,) [rad].

        Raises ParameterError where that cannot be.
        """

    @abstractmethod
    def held(self, state: State) -> Self:
        """The robot whose end effector somebody holds where it is. Raises ParameterError where it has none."""

    @abstractmethod
    def released(self) -> Self:
        """The robot that nobody holds."""


@dataclass(frozen=True, eq=False)
class ArmBody(Body[ArmState]):
    """An arm. Raises ParameterError for a posture that its springs cannot hold."""

    arm: VsaArm
    posture: Array  # (n,) [rad] link angles at the start
    walls: tuple[Contact, ...] = ()
    hand: Hand | None = None
    substeps: int = 2  # per period of a millisecond; twice as many where something is touched

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
        still = np.zeros(self.arm.n)
        return ArmState(self.posture, still, self.arm.rest(self.posture), still)

    def step(self, state: ArmState, torque: Array, period: float) -> ArmState:
        contacts = self._contacts
        substeps = 2 * self.substeps if contacts else self.substeps
        return arm_step(self.arm, state, torque, np.zeros(self.arm.n), period, substeps, contacts)

    def given(self, state: ArmState, torque: Array) -> Array:
        return given_torque(self.arm, state.motor_velocity, torque)

    def stopped(self, state: ArmState) -> ArmState:
        still = np.zeros(self.arm.n)
        return ArmState(state.q, still, state.theta, still)

    def reading(self, state: ArmState) -> BodyReading:
        spring_torque, _, _ = self.arm.spring_state(state.q - state.theta)
        return BodyReading(state.q, state.velocity, state.theta, state.motor_velocity, spring_torque)

    def contact_force(self, state: ArmState) -> Array:
        return contact_force(self.arm, state.q, state.velocity, self._contacts)

    def base(self, state: ArmState) -> Array | None:
        return None

    def pushed(self, state: ArmState, impulse: Array, deflection: Array) -> ArmState:
        blow = np.linalg.solve(self.arm.inertia(state.q), impulse)
        after = replace(state, q=state.q + deflection, velocity=state.velocity + blow)
        beyond = np.abs(after.q - after.theta) > self.arm.deflection_limit
        if beyond.any():
            raise ParameterError(f"springs would be beyond their stops: deflections {after.q - after.theta} rad")
        return after

    def held(self, state: ArmState) -> Self:
        return replace(self, hand=Hand(self.arm.tip_position(state.q)))

    def released(self) -> Self:
        return replace(self, hand=None)
