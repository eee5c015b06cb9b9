"""Kinematic Kalman filters: angle and velocity from an encoder without any model of what moves it.

Source: SAPHARI deliverable, eqs. (53), (54): constant velocity, driven by white acceleration of variance V_a,

    x(k) = x + T v,  v(k) = v,   Q = V_a G G',  G = (T^2/2, T)',      z(k) = x(k) + nu(k),  Var nu = R

The modified filter (MKKF) is named there and left to reference [9]: its measurement has the variance that suits an
encoder's quantisation. Our reading. A reading z of an encoder with quantum d says that x lies in [z - d/2, z + d/2] and
nothing else. As Gaussian noise of variance d^2/12, new at every sample, it would promise ever more while the reading
stands still, and pull x to the middle of the interval. So the predicted Gaussian N(m, S) of the reading is cut off at
the interval's ends, and mean and variance of what is left are matched. With a, b = (z -+ d/2 - m)/sqrt(S):

    E = m + sqrt(S) e,   Var = S r,   e = (f(a) - f(b)) / Z,   r = 1 + (a f(a) - b f(b)) / Z - e^2,   Z = F(b) - F(a)

(f, F: density and distribution of N(0, 1)). That is a linear measurement of variance R = S r / (1 - r) that changes
from sample to sample: small when the reading flips, for then x is at the edge, d^2/12 when x moves by many quanta per
sample. A reading that repeats itself is no second measurement: it is passed over unless the prediction has left the
interval or become as wide as the interval itself (S > d^2/12). So P stays consistent however slow the motion
(reported over empirical deviation .9-1.1, where the plain filter with R = d^2/12 promises up to five times too much)
and bounded at standstill. A prediction far outside (Z of a few 1e-9) is a model that failed: then d^2/12 it is, too.

A filter's state (6,) is x [rad], v [rad/s], the covariance P_xx, P_xv, P_vv, and the last reading [rad].
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from via_core.errors import ParameterError
from via_core.signals import Array

ANGLE, VELOCITY, P_XX, P_XV, P_VV, READING, SIZE = range(7)
_NARROW, _UNLIKELY = 1e-3, 1e-8  # interval in deviations that is a point; probability that is none


@njit(cache=True, error_model="numpy")
def start(state: Array, angle: float, variance: float, fastest: float) -> None:
    """Overwrite a filter's state (6,): at `angle` [rad] with `variance` [rad^2], velocity 0 +- `fastest` [rad/s]."""
    state[ANGLE], state[VELOCITY] = angle, 0.0
    state[P_XX], state[P_XV], state[P_VV] = variance, 0.0, fastest * fastest
    state[READING] = angle


@njit(cache=True, error_model="numpy")
def predict(state: Array, T: float, V: float) -> None:
    """T [s] later, eq. (53); V = V_a [(rad/s^2)^2]."""
    state[ANGLE] += T * state[VELOCITY]
    half = 0.5 * T * T
    state[P_XX] += T * (2.0 * state[P_XV] + T * state[P_VV]) + V * half * half
    state[P_XV] += T * state[P_VV] + V * half * T
    state[P_VV] += V * T * T


@njit(cache=True, error_model="numpy")
def _update(state: Array, S: float, shift: float, left: float) -> None:
    """The reading, predicted with variance S, is known to be `shift` further on average, with the variance left * S."""
    K, L = state[P_XX] / S, state[P_XV] / S
    state[ANGLE] += K * shift
    state[VELOCITY] += L * shift
    gone = (1.0 - left) * S
    state[P_XX] = max(state[P_XX] - gone * K * K, 0.0)
    state[P_XV] -= gone * K * L
    state[P_VV] = max(state[P_VV] - gone * L * L, 0.0)


@njit(cache=True, error_model="numpy")
def correct(state: Array, z: float, R: float) -> None:
    """Take a reading z [rad] with white noise of variance R > 0 [rad^2], eq. (54)."""
    S = state[P_XX] + R
    _update(state, S, z - state[ANGLE], 0.0)


@njit(cache=True, error_model="numpy")
def correct_quantised(state: Array, z: float, quantum: float, R: float) -> None:
    """Take a reading z [rad] of an encoder with a quantum > 0 [rad] and white noise of variance R before it [rad^2]."""
    S = state[P_XX] + R
    s, away = sqrt(S), z - state[ANGLE]
    again, state[READING] = z == state[READING], z
    if again and abs(away) <= 0.5 * quantum and quantum * quantum / 12.0 >= S:
        return
    if not quantum > _NARROW * s:
        correct(state, z, R + quantum * quantum / 12.0)
        return
    side = 1.0 if away >= 0.0 else -1.0  # mirrored so that the interval lies ahead, where erfc keeps its digits
    a, b = (side * away - 0.5 * quantum) / s, (side * away + 0.5 * quantum) / s
    Z = 0.5 * (erfc(a / sqrt(2.0)) - erfc(b / sqrt(2.0)))
    if not Z > _UNLIKELY:
        correct(state, z, R + quantum * quantum / 12.0)
        return
    fa, fb = exp(-0.5 * a * a) / sqrt(2.0 * pi), exp(-0.5 * b * b) / sqrt(2.0 * pi)
    e = (fa - fb) / Z
    left = min(max(1.0 + (a * fa - b * fb) / Z - e * e, 0.0), 1.0)
    _update(state, S, side * s * e, left)


def kinematic_kalman(
    readings: ArrayLike, interval: float, acceleration: float, noise: float, quantum: float = 0.0, fastest: float = 10.0
) -> tuple[Array, Array]:
    """Filter a whole record: states (N, 2) [rad, rad/s] and their covariances (N, 3) P_xx, P_xv, P_vv.

    readings      (N,) [rad]
    interval      T [s]
    acceleration  sqrt(V_a) [rad/s^2]
    noise         [rad] standard deviation of white noise on the readings
    quantum       [rad] of the encoder: the modified filter; 0: the plain one
    fastest       [rad/s] standard deviation of the velocity at the start

    Raises ParameterError for readings or numbers that are not finite or of the wrong sign.
    """
    z = np.array(readings, dtype=np.float64)
    numbers = (interval, acceleration, noise, quantum, fastest)
    if z.ndim != 1 or not z.size or not np.all(np.isfinite(z)):
        raise ParameterError(f"readings must be finite and (N,), got shape {z.shape}")
    if not np.all(np.isfinite(numbers)) or min(numbers) < 0.0 or not interval > 0.0 or not noise + quantum > 0.0:
        raise ParameterError(f"interval and noise or quantum must be > 0, the rest >= 0, got {numbers}")
    out = np.empty((len(z), SIZE))
    _run(z, interval, acceleration**2, noise**2, quantum, fastest, out)
    return out[:, :2], out[:, 2:5]


@njit(cache=True, error_model="numpy")
def _run(z: Array, T: float, V: float, R: float, quantum: float, fastest: float, out: Array) -> None:
    state = np.empty(SIZE)
    start(state, z[0], R + quantum * quantum / 12.0, fastest)
    out[0] = state
    for k in range(1, z.size):
        predict(state, T, V)
        if quantum > 0.0:
            correct_quantised(state, z[k], quantum, R)
        else:
            correct(state, z[k], R)
        out[k] = state
