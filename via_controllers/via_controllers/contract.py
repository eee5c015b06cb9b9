"""Interfaces of the controllers: frozen parameters, pure `init` and `step`, torques within the limits.

Controller     controls one joint
ArmController  controls an arm of n flexible joints: one sample of all joints in, all motor torques out
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
from via_core.vsa_arms import VsaArm

State = TypeVar("State")
Sample = TypeVar("Sample")  # JointSample or ArmSample


@dataclass(frozen=True)
class JointSample:
    """Measurements of a joint at one time; NaN where a value is missing."""

    time: float  # [s]
    q: float  # [rad] link angle
    theta: Array  # (m,) [rad] motor angles

    @property
    def valid(self) -> bool:
        """Whether all values are finite."""
        return math.isfinite(self.time) and math.isfinite(self.q) and bool(np.isfinite(self.theta).all())


@dataclass(frozen=True)
class ArmSample:
    """Measurements of an arm of n flexible joints at one time; NaN where a value is missing."""

    time: float  # [s]
    q: Array  # (n,) [rad] link angles
    q_velocity: Array  # (n,) [rad/s]
    theta: Array  # (n,) [rad] motor angles
    theta_velocity: Array  # (n,) [rad/s]
    spring_torque: Array  # (n,) [N m] tau_e of torque sensors; NaN without sensors
    lead: float = 0.0  # [s] by which it is predicted: it was measured at time - lead

    @property
    def valid(self) -> bool:
        """Whether time, angles and velocities are finite; torque sensors are optional."""
        return math.isfinite(self.time) and _finite(self.q, self.q_velocity, self.theta, self.theta_velocity)


@dataclass(frozen=True)
class Torques:
    """Output of a controller: motor torques within the limits."""

    torque: Array  # (m,) [N m]
    saturated: bool  # whether a torque was cut to its limit


@dataclass(frozen=True)
class Quantity:
    """An internal quantity of a controller that is published and plotted."""

    name: str  # e.g. H, z_1
    unit: str  # SI, '-' for none


class ControlLaw(ABC, Generic[State, Sample]):
    """What controllers of joints and of arms share; their parameters are their fields."""

    @abstractmethod
    def step(self, state: State, sample: Sample) -> tuple[State, Torques]:
        """The next state and the torques for `sample`; `state` is not modified.

        For an invalid sample torques are zero and the state is unchanged.
        """

    @property
    @abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """Names and units of the k values of `observe`; constant."""

    @abstractmethod
    def observe(self, state: State) -> Array:
        """Values (k,) of `quantities` at the last valid sample."""


class Controller(ControlLaw[State, JointSample]):
    """A controller of a joint."""

    @abstractmethod
    def init(self) -> State:
        """The state before the first sample."""


class ArmController(ControlLaw[State, ArmSample]):
    """A controller of an arm."""

    @abstractmethod
    def init(self, sample: ArmSample) -> State:
        """The state before the first sample; `sample` is this first sample and valid."""

    def model(self, state: State) -> VsaArm | None:
        """The arm as far as the controller knows it in `state`; None: as its file says."""
        return None


def passive(motors: int) -> Torques:
    """Zero torque for this number of motors."""
    return Torques(np.zeros(motors), False)


def limited(torque: Array, limit: Array) -> Torques:
    """`torque` (m,) clipped to +-`limit` (m,), both [N m]; entries that are not finite become zero."""
    return Torques(*limited_torque(torque, limit))


@njit(cache=True, error_model="numpy")
def _finite(first: Array, second: Array, third: Array, fourth: Array) -> bool:
    # Array by array: a compiled loop needs arrays of one type, and read-only arrays have another type.
    return bool(
        np.isfinite(first).all()
        and np.isfinite(second).all()
        and np.isfinite(third).all()
        and np.isfinite(fourth).all()
    )


@njit(cache=True, error_model="numpy")
def limited_torque(torque: Array, limit: Array) -> tuple[Array, bool]:
    """As `limited`, for compiled controllers: torques (m,), and whether one of them was changed."""
    out, saturated = np.zeros(torque.size), False
    for i in range(torque.size):
        if np.isfinite(torque[i]):
            out[i] = min(max(torque[i], -limit[i]), limit[i])
        saturated |= out[i] != torque[i]
    return out, saturated


def rounded_down(value: float) -> str:
    """A positive number with two digits, not above it: for the largest possible value in an error."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / digit) * digit:.2g}"


def require(condition: bool, message: str) -> None:
    """Raise ParameterError with `message` unless `condition` holds."""
    if not condition:
        raise ParameterError(message)


def require_positive(owner: object, *names: str) -> None:
    """Raise ParameterError for the first of these fields of `owner` that is not finite and > 0."""
    for name in names:
        value = getattr(owner, name)
        require(math.isfinite(value) and value > 0.0, f"{name} must be > 0, got {value}")


def require_not_negative(owner: object, *names: str) -> None:
    """Raise ParameterError for the first of these fields of `owner` that is not finite and >= 0."""
    for name in names:
        value = getattr(owner, name)
        require(math.isfinite(value) and value >= 0.0, f"{name} must be >= 0, got {value}")
