"""Spring laws: flexibility torque tau_e(phi) and stiffness sigma(phi) = d tau_e / d phi, phi = q - theta (eqs. 1-8).

A class per spring law: its parameters, as a device file states them, their checks, and the row of coefficients with
which compiled code evaluates the equations of its `kind` (spring_equations.py). Plants, estimators and plots share it.

`preset` [rad] is a motor angle on which the torque depends besides the deflection: of the stiffness motor in a serial
arrangement, of the transmission's own motor, theta_i, in an antagonistic one. Most springs ignore it. The stiffness is
the derivative at constant preset. Beyond `max_deflection` a spring law is undefined and may be NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import asin, sqrt
from typing import Annotated, ClassVar, Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Discriminator, Field, WrapValidator

from via_core.errors import ParameterError
from via_core.records import Number, Positive, refused
from via_core.signals import Array, locked
from via_core.spring_equations import (
    EXPONENTIAL,
    FOUR_BAR,
    MACCEPA,
    N_COEFFICIENTS,
    ODD_POLYNOMIAL,
    SINH,
    TWO_LEVER,
    spring_stiffness,
    spring_stiffness_slope,
    spring_torque,
)


@njit(cache=True, error_model="numpy")
def _torque_each(kind: int, c: Array, phi: Array, preset: Array, out: Array) -> None:
    for n in range(phi.size):
        out[n] = spring_torque(kind, c, phi[n], preset[n])


@njit(cache=True, error_model="numpy")
def _stiffness_each(kind: int, c: Array, phi: Array, preset: Array, out: Array) -> None:
    for n in range(phi.size):
        out[n] = spring_stiffness(kind, c, phi[n], preset[n])


@njit(cache=True, error_model="numpy")
def _slope_each(kind: int, c: Array, phi: Array, preset: Array, out: Array) -> None:
    for n in range(phi.size):
        out[n] = spring_stiffness_slope(kind, c, phi[n], preset[n])


Kernel = Callable[[int, Array, Array, Array, Array], None]


@dataclass(frozen=True)
class SpringLaw(ABC):
    """Torque-deflection characteristic of a flexible transmission; files select one by its name, such as `law: sinh`.

    max_deflection  [rad] mechanical stop
    odd             whether tau_e(-phi) = -tau_e(phi), so that an odd basis can represent it
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", serialize_by_alias=True)
    max_deflection: Positive
    kind: ClassVar[int]
    odd: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, str) and not np.all(np.isfinite(value)):
                raise ParameterError(f"{name} must be finite, got {value}")
        _positive(self, "max_deflection")
        self._check()

    @abstractmethod
    def coefficients(self) -> Array:
        """Coefficient row (8,) of the compiled kernels."""

    @abstractmethod
    def _check(self) -> None:
        """Raise ParameterError for invalid parameters."""

    def torque(self, phi: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """tau_e [N m] at deflection phi [rad] and preset [rad], broadcast together."""
        return self._each(_torque_each, phi, preset)

    def torque_at(self, phi: float, preset: float = 0.0) -> float:
        """tau_e [N m] at one deflection phi [rad] and preset [rad]: `torque` in a tenth of its time."""
        return float(spring_torque(self.kind, self._coefficients, phi, preset))

    @cached_property
    def _coefficients(self) -> Array:
        return locked(self.coefficients(), "coefficients")

    def stiffness(self, phi: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """sigma [N m/rad] at deflection phi [rad] and preset [rad], broadcast together."""
        return self._each(_stiffness_each, phi, preset)

    def stiffness_slope(self, phi: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """d sigma / d phi [N m/rad^2] at deflection phi [rad] and preset [rad], broadcast together."""
        return self._each(_slope_each, phi, preset)

    def inverse(self, torque: float, preset: float = 0.0) -> float:
        """A deflection [rad] within the stops with spring torque `torque` [N m]; unique for an increasing torque.

        Raises ParameterError where `torque` is outside of the torques at the two stops.
        """
        stop = self.max_deflection
        low, high = self.torque_at(-stop, preset), self.torque_at(stop, preset)
        if not low <= torque <= high:
            raise ParameterError(
                f"no deflection within {stop} rad gives {torque} N m; the spring reaches {low:.6g} to {high:.6g} N m"
            )
        if torque in (low, high):
            return stop if torque == high else -stop
        from scipy.optimize import brentq  # takes 0.2 s to import; most programs invert no spring law

        return float(brentq(lambda phi: self.torque_at(phi, preset) - torque, -stop, stop, xtol=1e-14, rtol=1e-14))

    def _each(self, kernel: Kernel, phi: ArrayLike, preset: ArrayLike) -> Array:
        at, along = np.broadcast_arrays(np.asarray(phi, dtype=np.float64), np.asarray(preset, dtype=np.float64))
        out = np.empty(at.size)
        # flatten() copies: the kernels see one array type and compile once
        kernel(self.kind, self.coefficients(), at.flatten(), along.flatten(), out)
        return out.reshape(at.shape)


def _positive(spring: SpringLaw, *names: str) -> None:
    for name in names:
        if not getattr(spring, name) > 0.0:
            raise ParameterError(f"{name} must be > 0, got {getattr(spring, name)}")


def _row(*values: float) -> Array:
    row = np.zeros(N_COEFFICIENTS)
    row[: len(values)] = values
    return row


@dataclass(frozen=True)
class OddPolynomialSpring(SpringLaw):
    """tau_e = sum_p c_p phi^(2p+1): a linear spring is (k,), the cubic spring (35) is (0, 10)."""

    odd_coefficients: tuple[Number, ...]  # c_p [N m/rad^(2p+1)], at most 8
    law: Literal["odd_polynomial"] = field(default="odd_polynomial", kw_only=True)
    kind: ClassVar[int] = ODD_POLYNOMIAL

    def _check(self) -> None:
        count = len(self.odd_coefficients)
        if not 1 <= count <= N_COEFFICIENTS:
            raise ParameterError(f"odd_coefficients needs 1 to {N_COEFFICIENTS} values, got {count}")
        if not any(self.odd_coefficients):
            raise ParameterError("odd_coefficients must not all be 0")
        # sigma is a polynomial in s = phi^2: its minimum is at 0, at the stop, or where its slope vanishes
        sigma = np.polynomial.Polynomial([(2 * p + 1) * c for p, c in enumerate(self.odd_coefficients)])
        stop = self.max_deflection**2
        roots = np.asarray(sigma.deriv().roots(), dtype=np.complex128)
        flat = [float(root.real) for root in roots if 0.0 < root.real < stop]
        for s in (0.0, stop, *flat):
            if sigma(s) < -1e-9 * abs(sigma(stop)):
                raise ParameterError(
                    f"odd_coefficients {self.odd_coefficients} give a negative stiffness of {sigma(s):.6g} N m/rad "
                    f"at a deflection of {sqrt(s):.6g} rad"
                )

    def coefficients(self) -> Array:
        return _row(*self.odd_coefficients)


@dataclass(frozen=True)
class LinearSpring(SpringLaw):
    """tau_e = k phi; a file calls k `stiffness`."""

    k: Annotated[Positive, Field(alias="stiffness")]  # [N m/rad]
    law: Literal["linear"] = field(default="linear", kw_only=True)
    kind: ClassVar[int] = ODD_POLYNOMIAL

    def _check(self) -> None:
        _positive(self, "k")

    def coefficients(self) -> Array:
        return _row(self.k)


@dataclass(frozen=True)
class CubicSpring(SpringLaw):
    """tau_e = c phi^3, eq. (35)."""

    coefficient: Positive  # c [N m/rad^3]
    law: Literal["cubic"] = field(default="cubic", kw_only=True)
    kind: ClassVar[int] = ODD_POLYNOMIAL

    def _check(self) -> None:
        _positive(self, "coefficient")

    def coefficients(self) -> Array:
        return _row(0.0, self.coefficient)


@dataclass(frozen=True)
class SinhSpring(SpringLaw):
    """tau_e = k sinh(a phi), the spring of the qbmove family."""

    k: Positive  # [N m]
    a: Positive  # [1/rad]
    law: Literal["sinh"] = field(default="sinh", kw_only=True)
    kind: ClassVar[int] = SINH

    def _check(self) -> None:
        _positive(self, "k", "a")

    def coefficients(self) -> Array:
        return _row(self.k, self.a)


@dataclass(frozen=True)
class ExponentialSpring(SpringLaw):
    """tau_e = k (rise e^(a phi) - fall e^(-a phi)): one side of the DLR BAVS; the other swaps rise and fall.

    At preset 0 the two sides are already pretensioned: tau_e(0) = k (rise - fall) is not 0.
    Source: bavs_plugin.cpp of NMMI/ROS-Gazebo-compliant-actuators-plugin, written for theta - q = -phi.
    """

    k: Positive  # [N m]
    rise: Positive  # [-]
    fall: Positive  # [-]
    a: Positive  # [1/rad]
    law: Literal["exponential"] = field(default="exponential", kw_only=True)
    kind: ClassVar[int] = EXPONENTIAL
    odd: ClassVar[bool] = False

    def _check(self) -> None:
        _positive(self, "k", "rise", "fall", "a")

    def coefficients(self) -> Array:
        return _row(self.k * self.rise, self.k * self.fall, self.a)


@dataclass(frozen=True)
class FourBarSpring(SpringLaw):
    """tau_e = 2 k beta(phi) dbeta/dphi of the VSA-II four-bar linkage, eqs. (50)-(51)."""

    k: Positive  # [N m/rad] spring inside the linkage
    ratio: Annotated[Number, Field(gt=1.0)]  # C [-] of eq. (51)
    law: Literal["four_bar"] = field(default="four_bar", kw_only=True)
    kind: ClassVar[int] = FOUR_BAR

    def _check(self) -> None:
        _positive(self, "k")
        if not self.ratio > 1.0:
            raise ParameterError(f"ratio must be > 1, got {self.ratio}")
        dead_point = 2.0 * asin(1.0 / self.ratio)
        if not self.max_deflection < dead_point:
            raise ParameterError(
                f"max_deflection must be below the linkage's dead point {dead_point:.6g} rad, got {self.max_deflection}"
            )

    def coefficients(self) -> Array:
        return _row(self.k, self.ratio)


@dataclass(frozen=True)
class MaccepaSpring(SpringLaw):
    """tau_e = K B C sin(phi) (1 + (r preset - A0)/A), A = sqrt(B^2 + C^2 - 2 B C cos phi): a spring over a lever.

    The preset motor winds up `drum_radius * preset` of cord. Source: equations of the MACCEPA-VD robot, written with
    the opposite sign for m1 - q = -phi.
    """

    k: Positive  # K [N/m] spring rate
    lever: Positive  # B [m]
    base: Positive  # C [m]
    free_length: Positive  # A0 [m] length A at which the spring is slack at preset 0; C - B in the robot
    drum_radius: Positive  # r [m]
    law: Literal["maccepa"] = field(default="maccepa", kw_only=True)
    kind: ClassVar[int] = MACCEPA

    def _check(self) -> None:
        _positive(self, "k", "lever", "base", "free_length", "drum_radius")
        if self.lever == self.base:
            raise ParameterError(f"lever and base must differ (A would vanish), both are {self.lever} m")

    def coefficients(self) -> Array:
        b, c = self.lever, self.base
        return _row(self.k * b * c, b * b + c * c, 2.0 * b * c, self.drum_radius, self.free_length)


@dataclass(frozen=True)
class TwoLeverSpring(SpringLaw):
    """A linear spring between the tips of a lever on the link and a lever on a motor: one side of the Edinburgh VSA.

    The torque depends on link and motor angle separately; it is neither odd nor increasing everywhere.
    With A = a (cos x, sin x), T = (h + L sin u, L cos u - d), s = |T - A|:

        tau_e = side K a (1 - s0/s) (T_x sin x - T_y cos x),   x = side q,   u = -side theta

    Source: libedinburghvsa.c of the Edinburgh VSA model (after Mitrovic, Klanke and Vijayakumar, 2011), where both
    servo angles are positive outwards. Here both are positive in the direction of the link, so that motor angles are
    equilibrium +- preset as in every antagonistic joint. Its spring 1 is side -1, its spring 2 side +1. As in the
    source, a spring shorter than s0 pushes.
    """

    k: Positive  # kappa [N/m] spring rate
    rest_length: Positive  # s0 [m]
    motor_lever: Positive  # L [m]
    link_lever: Positive  # a [m]
    offset: Number  # h [m] across, from the link axis to the motor axis
    distance: Positive  # d [m] along, from the link axis to the motor axis
    side: Literal[-1, 1]
    law: Literal["two_lever"] = field(default="two_lever", kw_only=True)
    kind: ClassVar[int] = TWO_LEVER
    odd: ClassVar[bool] = False

    def _check(self) -> None:
        _positive(self, "k", "rest_length", "motor_lever", "link_lever", "distance")
        if self.side not in (-1.0, 1.0):
            raise ParameterError(f"side must be -1 or 1, got {self.side}")
        # smallest distance between the circles of the two lever tips
        gap = sqrt(self.offset**2 + self.distance**2) - self.motor_lever - self.link_lever
        if not gap > 0.0:
            raise ParameterError(f"the levers must not reach each other, but their circles overlap by {-gap:.6g} m")

    def coefficients(self) -> Array:
        return _row(self.k, self.rest_length, self.motor_lever, self.link_lever, self.offset, self.distance, self.side)


Spring = Annotated[  # selected by its name, such as `law: sinh`
    LinearSpring
    | CubicSpring
    | OddPolynomialSpring
    | SinhSpring
    | ExponentialSpring
    | FourBarSpring
    | MaccepaSpring
    | TwoLeverSpring,
    Discriminator("law"),
    WrapValidator(refused),
]
