"""What every control law of this package looks like: frozen parameters, pure `init` and `step`, limited torque out.

Controller     a law of one joint
ArmController  a law of an arm of n flexible joints: all of them in one sample, all torques in one answer
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numba import njit
from via_core.errors import ParameterError
from via_core.signals import Array

State = TypeVar("State")


@dataclass(frozen=True)
class JointSample:
    """What a joint's sensors said at one stamp; NaN where nothing was measured."""

    time: float  # [s]
    q: float  # [rad] link angle
    theta: Array  # (m,) [rad] motor angles


@dataclass(frozen=True)
class ArmSample:
    """What the sensors of an arm of n flexible joints said at one stamp; NaN where nothing was measured."""

    time: float  # [s]
    q: Array  # (n,) [rad] link angles
    q_velocity: Array  # (n,) [rad/s]
    theta: Array  # (n,) [rad] motor angles
    theta_velocity: Array  # (n,) [rad/s]
    spring_torque: Array  # (n,) [N m] tau_e of a torque sensor; NaN where there is none


@dataclass(frozen=True)
class Torques:
    """What a law commands: motor torques that already respect the limits."""

    torque: Array  # (m,) [N m]
    saturated: bool  # some motor would have been asked for more


@dataclass(frozen=True)
class Quantity:
    """Something that a law knows and others want to see."""

    name: str  # what plots and messages call it: H, z_1
    unit: str  # SI, '-' for none


class Telling(ABC, Generic[State]):
    """What every law tells of its state."""

    @property
    @abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """What `told` tells, always the same k quantities in the same order."""

    @abstractmethod
    def told(self, state: State) -> Array:
        """Values (k,) of `quantities` at the last sample that was not blind."""


class Controller(Telling[State]):
    """A control law of a joint; its parameters are its fields."""

    @abstractmethod
    def init(self) -> State:
        """The state before the first sample."""

    @abstractmethod
    def step(self, state: State, sample: JointSample) -> tuple[State, Torques]:
        """The torques that answer `sample`, and the next state; `state` stays as it was."""


class ArmController(Telling[State]):
    """A control law of a whole arm; its parameters are its fields."""

    @abstractmethod
    def init(self, sample: ArmSample) -> State:
        """The state before the first sample, which is this one and not `blind`."""

    @abstractmethod
    def step(self, state: State, sample: ArmSample) -> tuple[State, Torques]:
        """The torques that answer `sample`, and the next state; `state` stays as it was.

        A `blind` sample leaves motors passive and the state as it is.
        """


def blind(sample: ArmSample) -> bool:
    """Whether an angle or a velocity of the arm is unknown; a torque sensor may be missing."""
    return not (
        math.isfinite(sample.time) and _finite(sample.q, sample.q_velocity, sample.theta, sample.theta_velocity)
    )


def limited(torque: Array, limit: Array) -> Torques:
    """`torque` (m,) clipped to +-`limit` (m,), both [N m]; what is not finite becomes zero: a passive motor."""
    return Torques(*_limited(torque, limit))


@njit(cache=True, error_model="numpy")
def _finite(first: Array, second: Array, third: Array, fourth: Array) -> bool:
    # array by array: locked ones are another type, and a compiled loop runs over one type only
    return bool(
        np.isfinite(first).all()
        and np.isfinite(second).all()
        and np.isfinite(third).all()
        and np.isfinite(fourth).all()
    )


@njit(cache=True, error_model="numpy")
def _limited(torque: Array, limit: Array) -> tuple[Array, bool]:
    """Clipped torques (m,), and whether one of them was more."""
    out, saturated = np.zeros(torque.size), False
    for i in range(torque.size):
        if np.isfinite(torque[i]):
            out[i] = min(max(torque[i], -limit[i]), limit[i])
        saturated |= out[i] != torque[i]
    return out, saturated


def require(condition: bool, message: str) -> None:
    """Raise ParameterError with `message` unless `condition` holds."""
    if not condition:
        raise ParameterError(message)


def require_positive(owner: object, *names: str) -> None:
    """Raise ParameterError for the first of these fields of `owner` that is not finite and > 0."""
    for name in names:
        value = getattr(owner, name)
        require(math.isfinite(value) and value > 0.0, f"{name} must be > 0, got {value}")
