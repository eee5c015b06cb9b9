"""Spring laws: flexibility torque tau_e(phi) and stiffness sigma(phi) = d tau_e / d phi, phi = q - theta (eqs. 1-8).

Each law is a pair of compiled scalar functions of (coefficients, deflection, preset), written once and used by plants,
estimators and pictures alike. A law is data on the compiled side: a `kind` and a row of coefficients, so that one
compiled kernel serves every law. `preset` [rad] is the position of the stiffness motor of a serial arrangement; laws
without one ignore it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import asin, asinh, cos, cosh, isfinite, sin, sinh, sqrt
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from via_core.errors import ParameterError
from via_core.signals import Array

ODD_POLYNOMIAL, SINH, FOUR_BAR, MACCEPA = range(4)
N_COEFFICIENTS = 8  # length of a coefficient row, the longest law fits


@njit(cache=True, error_model="numpy")
def spring_torque(kind: int, c: Array, phi: float, preset: float) -> float:
    """tau_e(phi) [N m] of law `kind` with coefficients c (8,)."""
    if kind == ODD_POLYNOMIAL:  # sum_p c_p phi^(2p+1)
        square = phi * phi
        total = 0.0
        for p in range(N_COEFFICIENTS - 1, -1, -1):
            total = total * square + c[p]
        return total * phi
    if kind == SINH:  # k sinh(a phi)
        return c[0] * sinh(c[1] * phi)
    if kind == FOUR_BAR:  # 2 k beta dbeta/dphi, eqs. (50)-(51)
        s = c[1] * sin(0.5 * phi)
        root = sqrt(1.0 - s * s)
        beta = asin(s) - 0.5 * phi
        slope = 0.5 * c[1] * cos(0.5 * phi) / root - 0.5
        return 2.0 * c[0] * beta * slope
    # MACCEPA: k B C sin(phi) (1 + (r preset - A0) / A), A the length of the free spring side
    kbc, b2_c2, two_bc, r, a0 = c[0], c[1], c[2], c[3], c[4]
    length = sqrt(b2_c2 - two_bc * cos(phi))
    return kbc * sin(phi) * (1.0 + (r * preset - a0) / length)


@njit(cache=True, error_model="numpy")
def spring_stiffness(kind: int, c: Array, phi: float, preset: float) -> float:
    """sigma(phi) [N m/rad] of law `kind` with coefficients c (8,)."""
    if kind == ODD_POLYNOMIAL:
        square = phi * phi
        total = 0.0
        for p in range(N_COEFFICIENTS - 1, -1, -1):
            total = total * square + (2 * p + 1) * c[p]
        return total
    if kind == SINH:
        return c[0] * c[1] * cosh(c[1] * phi)
    if kind == FOUR_BAR:
        s = c[1] * sin(0.5 * phi)
        half_cos = 0.5 * c[1] * cos(0.5 * phi)
        root = sqrt(1.0 - s * s)
        beta = asin(s) - 0.5 * phi
        slope = half_cos / root - 0.5
        bend = -0.25 * s / root + s * half_cos * half_cos / (root * root * root)
        return 2.0 * c[0] * (slope * slope + beta * bend)
    kbc, b2_c2, two_bc, r, a0 = c[0], c[1], c[2], c[3], c[4]
    length = sqrt(b2_c2 - two_bc * cos(phi))
    pull = r * preset - a0
    bent = 0.5 * two_bc * sin(phi) * sin(phi) / (length * length * length)
    return kbc * (cos(phi) * (1.0 + pull / length) - pull * bent)


@njit(cache=True, error_model="numpy")
def _torque_each(kind: int, c: Array, phi: Array, preset: Array, out: Array) -> None:
    for n in range(phi.size):
        out[n] = spring_torque(kind, c, phi[n], preset[n])


@njit(cache=True, error_model="numpy")
def _stiffness_each(kind: int, c: Array, phi: Array, preset: Array, out: Array) -> None:
    for n in range(phi.size):
        out[n] = spring_stiffness(kind, c, phi[n], preset[n])


@dataclass(frozen=True)
class SpringLaw(ABC):
    """An odd, increasing torque-deflection law of a flexible transmission.

    max_deflection  [rad] the mechanical stop; the law means nothing beyond it
    """

    max_deflection: float
    kind: ClassVar[int]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.all(np.isfinite(value)):
                raise ParameterError(f"{type(self).__name__}.{name} must be finite, got {value}")
        if not self.max_deflection > 0.0:
            raise ParameterError(f"max_deflection must be > 0 rad, got {self.max_deflection}")
        self._check()

    @abstractmethod
    def coefficients(self) -> Array:
        """The row (8,) that the compiled kernels take."""

    def _check(self) -> None:
        """Refuse parameters outside the law's own range; laws without one accept all."""

    def torque(self, phi: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """tau_e [N m] at deflection phi [rad] and preset [rad], broadcast together."""
        return self._each(_torque_each, phi, preset)

    def stiffness(self, phi: ArrayLike, preset: ArrayLike = 0.0) -> Array:
        """sigma [N m/rad] at deflection phi [rad] and preset [rad], broadcast together."""
        return self._each(_stiffness_each, phi, preset)

    def inverse(self, torque: float, preset: float = 0.0) -> float:
        """The deflection [rad] within the stop at which the law gives `torque` [N m].

        Raises ParameterError where the law reaches no such torque within its stop.
        """
        stop = self.max_deflection
        reach = float(self.torque(stop, preset))
        if not abs(torque) <= reach:
            raise ParameterError(f"no deflection within {stop} rad gives {torque} N m; the law reaches {reach:.6g} N m")
        if torque in (-reach, reach):
            return stop if torque > 0.0 else -stop
        return float(brentq(lambda phi: float(self.torque(phi, preset)) - torque, -stop, stop, xtol=1e-14, rtol=1e-14))

    def _each(self, kernel, phi: ArrayLike, preset: ArrayLike) -> Array:
        at, along = np.broadcast_arrays(np.asarray(phi, dtype=np.float64), np.asarray(preset, dtype=np.float64))
        out = np.empty(at.size)
        kernel(self.kind, self.coefficients(), np.ascontiguousarray(at).ravel(), np.ascontiguousarray(along).ravel(), out)
        return out.reshape(at.shape)


def _row(*values: float) -> Array:
    row = np.zeros(N_COEFFICIENTS)
    row[: len(values)] = values
    return row


@dataclass(frozen=True)
class OddPolynomialSpring(SpringLaw):
    """tau_e = sum_p c_p phi^(2p+1): a linear spring is (k,), the document's cubic spring (35) is (0, 10)."""

    odd_coefficients: tuple[float, ...]  # c_p [N m/rad^(2p+1)], at most 8
    kind: ClassVar[int] = ODD_POLYNOMIAL

    def _check(self) -> None:
        if not 1 <= len(self.odd_coefficients) <= N_COEFFICIENTS:
            raise ParameterError(f"odd_coefficients needs 1 to {N_COEFFICIENTS} values, got {len(self.odd_coefficients)}")

    def coefficients(self) -> Array:
        return _row(*self.odd_coefficients)


def linear_spring(stiffness: float, max_deflection: float) -> OddPolynomialSpring:
    """tau_e = k phi, k [N m/rad]."""
    return OddPolynomialSpring(max_deflection, (stiffness,))


def cubic_spring(coefficient: float, max_deflection: float) -> OddPolynomialSpring:
    """tau_e = c phi^3, c [N m/rad^3], eq. (35)."""
    return OddPolynomialSpring(max_deflection, (0.0, coefficient))


@dataclass(frozen=True)
class SinhSpring(SpringLaw):
    """tau_e = k sinh(a phi), the exponential spring of the qbmove family."""

    k: float  # [N m]
    a: float  # [1/rad]
    kind: ClassVar[int] = SINH

    def _check(self) -> None:
        if not (self.k > 0.0 and self.a > 0.0):
            raise ParameterError(f"k and a must be > 0, got k {self.k}, a {self.a}")

    def coefficients(self) -> Array:
        return _row(self.k, self.a)

    def inverse(self, torque: float, preset: float = 0.0) -> float:
        phi = asinh(torque / self.k) / self.a
        if not (isfinite(phi) and abs(phi) <= self.max_deflection):
            raise ParameterError(f"no deflection within {self.max_deflection} rad gives {torque} N m")
        return phi


@dataclass(frozen=True)
class FourBarSpring(SpringLaw):
    """tau_e = 2 k beta(phi) dbeta/dphi of the VSA-II four-bar linkage, eqs. (50)-(51)."""

    k: float  # [N m/rad] spring inside the linkage
    ratio: float  # C > 1 [-] of eq. (51)
    kind: ClassVar[int] = FOUR_BAR

    def _check(self) -> None:
        if not self.ratio > 1.0:
            raise ParameterError(f"ratio must be > 1, got {self.ratio}")
        if not self.ratio * sin(0.5 * min(self.max_deflection, 3.0)) < 1.0:
            raise ParameterError(
                f"max_deflection {self.max_deflection} rad lies beyond the linkage's dead point "
                f"{2.0 * asin(1.0 / self.ratio):.6g} rad"
            )

    def coefficients(self) -> Array:
        return _row(self.k, self.ratio)


@dataclass(frozen=True)
class MaccepaSpring(SpringLaw):
    """tau_e = K B C sin(phi) (1 + (r preset - A0)/A), A = sqrt(B^2 + C^2 - 2 B C cos phi): a spring pulled over a lever.

    Pretension by the preset motor winds `drum_radius * preset` of cord. Source: equations of the MACCEPA-VD robot
    (devices.md), there written with the opposite sign for m1 - q = -phi.
    """

    k: float  # K [N/m] spring rate
    lever: float  # B [m]
    base: float  # C [m]
    free_length: float  # A0 [m] length at which the spring is slack for preset 0
    drum_radius: float  # r [m]
    kind: ClassVar[int] = MACCEPA

    def _check(self) -> None:
        for name in ("k", "lever", "base", "free_length"):
            if not getattr(self, name) > 0.0:
                raise ParameterError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.lever == self.base:
            raise ParameterError(f"lever and base must differ (A would vanish), both are {self.lever} m")

    def coefficients(self) -> Array:
        b, c = self.lever, self.base
        return _row(self.k * b * c, b * b + c * c, 2.0 * b * c, self.drum_radius, self.free_length)
