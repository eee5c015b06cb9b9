"""What every control law of this package looks like: frozen parameters, pure `init` and `step`, limited torque out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
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


class Controller(ABC, Generic[State]):
    """A control law; its parameters are its fields."""

    @abstractmethod
    def init(self) -> State:
        """The state before the first sample."""

    @abstractmethod
    def step(self, state: State, sample: JointSample) -> tuple[State, Torques]:
        """The torques that answer `sample`, and the next state; `state` stays as it was."""


def limited(torque: Array, limit: Array) -> Torques:
    """`torque` (m,) clipped to +-`limit` (m,), both [N m]; what is not finite becomes zero: a passive motor."""
    finite = np.where(np.isfinite(torque), torque, 0.0)
    clipped = np.clip(finite, -limit, limit)
    return Torques(clipped, bool(np.any(clipped != torque)))


def require(condition: bool, message: str) -> None:
    """Raise ParameterError with `message` unless `condition` holds."""
    if not condition:
        raise ParameterError(message)
