"""Weak form: modulated signals <f, psi^(i)> over a sliding window, computed from samples and their stamps.

Modulating functions, eq. (13): w_hh(u) = (1 - u)^h u^h. All derivatives below the h-th vanish at 0 and 1, so w_hh has
order h ((12), Example 1, prints h + 1; but w_33''' is 6 and -6 at the ends). On a window of length T that ends at t,
with u = (s - t + T) / T,

    psi(s) = c_h / T w_hh(u),   c_h = (2h + 1)! / (h!)^2,   so that  integral psi ds = 1

and d/ds = (1/T) d/du. Integration by parts, i times, leaves no boundary terms for i <= h:

    <f^(i), psi> = (-1)^i <f, psi^(i)>,   <f, psi^(i)> = c_h / T^(i+1)  integral f(s) w_hh^(i)(u) ds

This moves derivatives from the measured signal to a known function. The motor equation (5) becomes
B <theta, psi''> - D <theta, psi'> - <tau_e(phi), psi> = <tau, psi>, without derivatives of measurements.

Discretisation: trapezoid weights on the actual stamps (eq. 24, where t_m = m/H on [0, 1] replaces the printed t_m = m
Ts). The oldest stamp is u = 0, the newest u = 1; (26) and (27) use the opposite direction, which flips the sign of <f,
psi'>. On a uniform window the error decreases as H^-(m+1), m the first odd number >= h - i (Euler-Maclaurin). On
jittered stamps plain trapezoids reach H^-2 only, and <1, psi''> is not 0, so that an encoder offset would bias an
estimate. Each row is therefore corrected by the lower ones until row i is exact for polynomials of degree <= i on any
stamps; the order on uniform stamps is unchanged. The third derivative, for the differentiated equations of Section 3,
is a separate function, so that the other estimators do not pay for it.
"""

from __future__ import annotations

from math import comb, factorial

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from via_core.errors import ParameterError
from via_core.signals import Array, locked

VECTOR = {"reassoc", "contract"}  # lets sums be vectorised; their order is fixed at compile time
ROWS = 3  # <f, psi>, <f, psi'>, <f, psi''>: enough for second-order dynamics


def modulating(order: int, derivative: int, u: ArrayLike) -> Array:
    """d^i w_hh / du^i at u (...) by Leibniz' rule, h = `order`, i = `derivative`; zero outside [0, 1].

    Eqs. (28)-(30), corrected: w_33''' = -6 w_03 + 54 w_12 - 54 w_21 + 6 w_30 (printed: + 6 w_03).
    Raises ParameterError for a negative order or derivative.
    """
    if order < 0 or derivative < 0:
        raise ParameterError(f"order and derivative must be >= 0, got {order} and {derivative}")
    at = np.asarray(u, dtype=np.float64)
    total = np.zeros_like(at)
    for j in range(max(0, derivative - order), min(derivative, order) + 1):  # j derivatives fall on u^h
        k = derivative - j  # and k on (1 - u)^h
        scale = (-1) ** k * comb(derivative, j) * factorial(order) ** 2 / (factorial(order - j) * factorial(order - k))
        total += scale * at ** (order - j) * (1.0 - at) ** (order - k)
    return np.where((at < 0.0) | (at > 1.0), 0.0, total)


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def half_widths(stamps: Array, first: int, out: Array) -> None:
    """Trapezoid weights [s] of the samples in a window: half of the two steps next to each.

    stamps, first  a ring buffer as in `fill_weights`; the oldest and the newest sample have one step only
    out            (n,) overwritten, in the storage order of `stamps`
    """
    n = stamps.size
    for k in range(1, n - 1):
        out[k] = 0.5 * (stamps[k + 1] - stamps[k - 1])
    out[0] = 0.5 * (stamps[1] - stamps[n - 1])
    out[n - 1] = 0.5 * (stamps[0] - stamps[n - 2])
    last = first - 1 if first > 0 else n - 1
    out[first] = 0.5 * (stamps[first + 1 if first + 1 < n else 0] - stamps[first])
    out[last] = 0.5 * (stamps[last] - stamps[last - 1 if last > 0 else n - 1])


@njit(cache=True, error_model="numpy", fastmath=VECTOR, inline="always")
def _rows_and_moments(order: int, stamps: Array, first: int, weights: Array) -> tuple[float, ...]:
    """Trapezoid rows of w_hh, w_hh', w_hh'' into `weights`; 1 / window length [1/s], then moments s_00, s_01, ... s_22.

    s_ij = sum of row_i x^j about the middle of the window, x = u - 1/2.
    """
    n = stamps.size
    oldest = stamps[first]
    newest = stamps[first - 1 if first > 0 else n - 1]
    rate = 1.0 / (newest - oldest)
    psi, slope_row, bend_row = weights[0], weights[1], weights[2]
    half_widths(stamps, first, psi)
    for k in range(n):
        u = (stamps[k] - oldest) * rate
        slope_row[k] = u * (1.0 - u)
        psi[k] *= rate
    for _ in range(order - 2):
        for k in range(n):
            psi[k] *= slope_row[k]  # p^(h-2) du in the end, p = u (1-u)
    s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
    for k in range(n):
        x = (stamps[k] - oldest) * rate - 0.5
        p = slope_row[k]
        slope = -2.0 * x
        power = psi[k]
        w0 = power * p * p
        w1 = power * p * order * slope
        w2 = power * order * ((order - 1.0) * slope * slope - 2.0 * p)
        psi[k] = w0
        slope_row[k] = w1
        bend_row[k] = w2
        square = x * x
        s00 += w0
        s01 += w0 * x
        s02 += w0 * square
        s10 += w1
        s11 += w1 * x
        s12 += w1 * square
        s20 += w2
        s21 += w2 * x
        s22 += w2 * square
    return rate, s00, s01, s02, s10, s11, s12, s20, s21, s22


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def fill_weights(order: int, stamps: Array, first: int, weights: Array) -> None:
    """Weights W such that <f, psi^(i)> = sum_n W[i, n] f[n] over one window, i = 0, 1, 2, for use in compiled loops.

    order    h >= 2 of w_hh
    stamps   (n,) [s], n >= 5, a ring buffer: stamps[first] is the oldest, then increasing, cyclic; first = 0 for a
             plain array. Not checked here.
    weights  (3, n) [1, 1/s, 1/s^2], overwritten, in the storage order of `stamps`: the loops need no unrolled copy and
             compile to vector instructions.
    """
    rate, s00, s01, s02, s10, s11, s12, s20, s21, s22 = _rows_and_moments(order, stamps, first, weights)
    # Row i minus multiples of the rows below it, scaled: <x^j, psi^(i)> = 0 for j < i, (-1)^i i! for j = i.
    a00 = 1.0 / s00
    c10 = s10 * a00
    a11 = -1.0 / (s11 - c10 * s01)
    a10 = -a11 * c10
    # moments of the finished rows: r0 = (1, m01, m02), r1 = (0, -1, m12)
    m01 = a00 * s01
    m02 = a00 * s02
    m12 = a11 * s12 + a10 * s02
    c20 = s20
    c21 = -(s21 - c20 * m01)
    a22 = 2.0 / (s22 - c20 * m02 - c21 * m12)
    b0 = -a22 * c20
    b1 = -a22 * c21
    rate2 = rate * rate
    psi, slope_row, bend_row = weights[0], weights[1], weights[2]
    for k in range(stamps.size):
        w0 = a00 * psi[k]
        w1 = a11 * slope_row[k] + a10 * psi[k]
        bend_row[k] = rate2 * (a22 * bend_row[k] + b1 * w1 + b0 * w0)
        slope_row[k] = rate * w1
        psi[k] = w0


@njit(cache=True, error_model="numpy", fastmath=VECTOR)
def fill_third(order: int, stamps: Array, first: int, weights: Array) -> None:
    """Row W[3] for <f, psi^(3)>, after `fill_weights` has written the other three into the same array.

    order    h >= 3 of w_hh; 3 suffices, although the third derivative of w_33 does not vanish at the ends
    stamps   (n,) [s], n >= 5, a ring buffer as in `fill_weights`
    weights  (4, n), rows 0..2 filled; row 3 [1/s^3] is overwritten
    """
    n = stamps.size
    oldest = stamps[first]
    newest = stamps[first - 1 if first > 0 else n - 1]
    rate = 1.0 / (newest - oldest)

    # Trapezoid row of w_hh^(3) = h (h-1) p^(h-3) p' ((h-2) p'^2 - 6 p), p = u (1-u), and the moments needed below.
    psi, slope_row, bend_row, third = weights[0], weights[1], weights[2], weights[3]
    half_widths(stamps, first, third)
    for k in range(n):
        third[k] *= rate
    for _ in range(order - 3):
        for k in range(n):
            u = (stamps[k] - oldest) * rate
            third[k] *= u * (1.0 - u)
    s0 = s1 = s2 = s3 = m01 = m02 = m03 = m12 = m13 = m23 = 0.0
    for k in range(n):
        u = (stamps[k] - oldest) * rate
        x = u - 0.5
        slope = -2.0 * x
        w3 = third[k] * order * (order - 1.0) * slope * ((order - 2.0) * slope * slope - 6.0 * u * (1.0 - u))
        third[k] = w3
        square = x * x
        cube = square * x
        s0 += w3
        s1 += w3 * x
        s2 += w3 * square
        s3 += w3 * cube
        m01 += psi[k] * x
        m02 += psi[k] * square
        m03 += psi[k] * cube
        m12 += slope_row[k] * square
        m13 += slope_row[k] * cube
        m23 += bend_row[k] * cube

    # Row 3 minus multiples of the rows below it, scaled: <x^j, psi^(3)> = 0 for j < 3, -3! for j = 3.
    span = 1.0 / rate
    c0 = s0
    c1 = (c0 * m01 - s1) * span
    c2 = 0.5 * (s2 - c0 * m02 - c1 * m12) * span * span
    scale = -6.0 * rate * rate * rate / (s3 - c0 * m03 - c1 * m13 - c2 * m23)
    for k in range(n):
        third[k] = scale * (third[k] - c0 * psi[k] - c1 * slope_row[k] - c2 * bend_row[k])


def window_weights(order: int, stamps: ArrayLike, rows: int = ROWS) -> Array:
    """Weights (rows, n) for stamps (n,) [s], oldest first, read-only: `fill_weights` with checked arguments.

    The fourth row, if requested, is that of `fill_third`. Raises ParameterError for any other number of rows, an order
    below the highest derivative, fewer than 5 stamps, or stamps that are not finite and strictly increasing.
    """
    if rows not in (ROWS, ROWS + 1):
        raise ParameterError(f"rows must be {ROWS} or {ROWS + 1}, got {rows}")
    if order < rows - 1:
        raise ParameterError(f"order must be >= {rows - 1} for derivatives up to that one, got {order}")
    at = np.array(stamps, dtype=np.float64)
    if at.ndim != 1 or at.size < 5:
        raise ParameterError(f"a window needs at least 5 stamps in one dimension, got shape {at.shape}")
    if not (np.all(np.isfinite(at)) and np.all(np.diff(at) > 0.0)):
        raise ParameterError("stamps of a window must be finite and strictly increasing")
    weights = np.empty((rows, at.size))
    fill_weights(order, at, 0, weights)
    if rows > ROWS:
        fill_third(order, at, 0, weights)
    return locked(weights, "weights")
