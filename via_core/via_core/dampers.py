"""Dampers: damping d(u) [N m s/rad] at damping command u, which is clipped to 0..1 as in the hardware.

As with springs, compiled code sees a map as a `kind` and a row of coefficients.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, ClassVar, Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Discriminator, WrapValidator

from via_core.errors import ParameterError
from via_core.records import NotNegative, Positive, refused
from via_core.signals import Array

LINEAR, TWO_STAGE = range(2)
N_DAMPER_COEFFICIENTS = 3


@njit(cache=True, error_model="numpy")
def damper_value(kind: int, c: Array, u: float) -> float:
    """d(u) [N m s/rad] of map `kind` with coefficients c (3,) at command u [-]."""
    if kind == LINEAR:
        return c[0] + c[1] * min(max(u, 0.0), 1.0)
    first = min(max(2.0 * u, 0.0), 1.0)
    second = min(max(2.0 * u - 1.0, 0.0), 1.0)
    return c[0] + c[1] * (first + c[2] * second)


@njit(cache=True, error_model="numpy")
def _value_each(kind: int, c: Array, u: Array, out: Array) -> None:
    for n in range(u.size):
        out[n] = damper_value(kind, c, u[n])


@dataclass(frozen=True, kw_only=True)
class Damper(ABC):
    """A damper and its map from damping command to damping, which `map` names in files."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    site: Literal["link", "transmission"]  # damping acts on qd, or on phid
    minimum: NotNegative = 0.0  # [N m s/rad] at command 0
    kind: ClassVar[int]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, str) and not (isfinite(value) and value >= 0.0):
                raise ParameterError(f"{name} must be finite and >= 0, got {value}")
        if not self.coefficients()[1] > 0.0:
            raise ParameterError(f"the damping must grow with the command, got {self}")

    @abstractmethod
    def coefficients(self) -> Array:
        """Coefficient row (3,) of the compiled kernel."""

    def value(self, u: ArrayLike) -> Array:
        """d(u) [N m s/rad], same shape as u [-]."""
        at = np.asarray(u, dtype=np.float64)
        out = np.empty(at.size)
        _value_each(self.kind, self.coefficients(), np.ascontiguousarray(at).ravel(), out)
        return out.reshape(at.shape)


@dataclass(frozen=True, kw_only=True)
class LinearDamper(Damper):
    """d(u) = minimum + (maximum - minimum) u."""

    maximum: Positive  # [N m s/rad] at command 1
    map: Literal["linear"] = "linear"
    kind: ClassVar[int] = LINEAR

    def coefficients(self) -> Array:
        return np.array([self.minimum, self.maximum - self.minimum, 0.0])


@dataclass(frozen=True, kw_only=True)
class TwoStageDamper(Damper):
    """d(u) = minimum + stage (clip(u/.5, 0, 1) + second clip((u - .5)/.5, 0, 1)), the electric brake of the MACCEPA-VD.

    The motor is braked by a growing duty cycle into a resistor, then short-circuited.
    """

    stage: Positive  # [N m s/rad] damping of the first stage, d_max of the source
    second: NotNegative  # [-] fraction of `stage` added by the second stage, .848 in the source
    map: Literal["two_stage"] = "two_stage"
    kind: ClassVar[int] = TWO_STAGE

    def coefficients(self) -> Array:
        return np.array([self.minimum, self.stage, self.second])


Damping = Annotated[LinearDamper | TwoStageDamper, Discriminator("map"), WrapValidator(refused)]
