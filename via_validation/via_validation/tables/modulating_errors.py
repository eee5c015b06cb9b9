"""Truncation and noise errors of one row of Section 3's estimator: eqs. (31)-(34), corrected, and Table 1.

Source: SAPHARI deliverable, Section 3.3. A row is A' Gamma(k) = C(k) + e_RN(k) + e_w(k), in the scale of (26), (27):

    e_RN(k) = -T^2 sum_m W_m w_hh'(m/H) rho_N(phi(k-H+m)),      rho_N(phi) = integral_0^phi (sigma - sigma_N)
    |e_RN|  <= 2 T^2 / 4^h sup |rho_N|                          h = 3: T^2 / 32
    e_w(k)  =  T^2 sum_m W_m w_hh'(m/H) omega(k-H+m),           Var e_w = s^2 T^4 sum_m (W_m w_hh'(m/H))^2

with W = 1/H, halved at both ends. Printed are sigma - sigma_N in place of its integral in (32), sample k - m, and in
(33) a bound T 5/8 sup |sigma - sigma_N|, which has a different unit and is violated by slow motion in long windows.
The bound follows from integral |w_hh'| du = 2 w_hh(1/2), since w_hh rises up to its middle, then falls.

Table 1. For small steps Var e_w -> s^2 T^3 Ts integral w_hh'^2 du: it grows with the sampling period (printed: falls).
Both errors must be compared with the row itself, whose regressors are T^3 / c_h (`row_scale`) times weighted means of
d/dt phi^(j+1)/(j+1)!: the relative noise of a row falls like T^-3/2 although e_w itself grows; relative truncation
error is a weighted mean of d/dt rho_N, which grows neither with T nor with Ts, and falls with N.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.springs import SpringLaw
from via_core.weak_form import modulating


def row_scale(span: float, order: int = 3) -> float:
    """T^3 / c_h [s^3]: a row of (25) divided by it is a weighted mean of rates of torque [N m/s].

    span   T [s] of the window
    order  h of the modulating function w_hh
    """
    _check(span, order)
    return span**3 * factorial(order) ** 2 / factorial(2 * order + 1)


def remainder(spring: SpringLaw, alpha: ArrayLike, phi: ArrayLike) -> Array:
    """rho_N(phi) [N m] at deflections phi (...) [rad]: torque not explained by a stiffness polynomial.

    alpha  (N + 1,) Taylor coefficients [N m/rad^(j+1)], sigma_N = sum_j alpha_j phi^j / j!
    """
    at = np.asarray(phi, dtype=np.float64)
    total = spring.torque(at) - spring.torque(0.0)
    for j, coefficient in enumerate(np.atleast_1d(alpha)):
        total = total - coefficient * at ** (j + 1) / factorial(j + 1)
    return np.asarray(total)


def truncation_errors(rho: ArrayLike, intervals: int, span: float, order: int = 3) -> Array:
    """e_RN(k) (n - H,) [N m s^2] of all full windows over samples rho (n,) of rho_N(phi(t)) [N m]; H = `intervals`."""
    values = np.asarray(rho, dtype=np.float64)
    kernel = _kernel(intervals, span, order)
    if values.ndim != 1 or values.size <= intervals:
        raise ParameterError(f"rho needs more than {intervals} samples in one dimension, got shape {values.shape}")
    return np.convolve(values, -kernel[::-1], "valid")


def truncation_bound(largest: float, span: float, order: int = 3) -> float:
    """Bound [N m s^2] on |e_RN|, where `largest` [N m] bounds |rho_N| over the deflections visited."""
    _check(span, order)
    return 2.0 * span**2 / 4.0**order * abs(largest)


def noise_variance(torque_noise: float, intervals: int, span: float, order: int = 3) -> float:
    """Var e_w [(N m s^2)^2] for white torque noise of that standard deviation [N m], H = `intervals` per window."""
    return float(torque_noise**2 * np.sum(_kernel(intervals, span, order) ** 2))


def noise_deviation(torque_noise: float, intervals: int, span: float, order: int = 3) -> float:
    """Standard deviation [N m/s] of a row over `row_scale`: noise as a rate of torque, the unit of a row."""
    return float(np.sqrt(noise_variance(torque_noise, intervals, span, order)) / row_scale(span, order))


def _kernel(intervals: int, span: float, order: int) -> Array:
    """T^2 W_m w_hh'(m/H) (H + 1,), oldest sample first."""
    _check(span, order)
    if intervals < 2:
        raise ParameterError(f"a window needs at least 2 intervals, got {intervals}")
    weights = np.full(intervals + 1, 1.0 / intervals)
    weights[[0, -1]] *= 0.5
    return span**2 * weights * modulating(order, 1, np.linspace(0.0, 1.0, intervals + 1))


def _check(span: float, order: int) -> None:
    if not (np.isfinite(span) and span > 0.0):
        raise ParameterError(f"span must be finite and > 0 s, got {span}")
    if order < 1:
        raise ParameterError(f"order must be >= 1 for a first derivative, got {order}")
