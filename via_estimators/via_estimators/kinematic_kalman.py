"""Kinematic Kalman filters: angle and velocity from an encoder, without a model of the mechanism.

Source: SAPHARI deliverable, eqs. (53), (54): constant velocity, driven by white acceleration of variance V_a,

    x(k) = x + T v,  v(k) = v,   Q = V_a G G',  G = (T^2/2, T)',      z(k) = x(k) + nu(k),  Var nu = R

The modified filter (MKKF) is named there, with details only in reference [9]: its measurement variance suits the
quantisation of an encoder. Implementation here: a measurement z of an encoder with quantum d means that x lies in [z -
d/2, z + d/2]. If it were treated as Gaussian noise of variance d^2/12, new at every sample, the variance would shrink
at standstill and x would converge to the middle of the interval. So the predicted Gaussian N(m, S) of the measurement
is truncated at the interval's ends, and mean and variance of the result are matched. With a, b = (z -+ d/2 -
m)/sqrt(S):

    E = m + sqrt(S) e,   Var = S r,   e = (f(a) - f(b)) / Z,   r = 1 + (a f(a) - b f(b)) / Z - e^2,   Z = F(b) - F(a)

(f, F: density and distribution of N(0, 1)). That is a linear measurement of variance R = S r / (1 - r) that changes
from sample to sample: small when the measurement changes, since x is then at the edge; d^2/12 when x moves by many
quanta per sample. A repeated measurement contains no new information: it is skipped unless the prediction has left the
interval or become as wide as the interval itself (S > d^2/12). So P is consistent however slow the motion (reported
over empirical standard deviation .9-1.1; the plain filter with R = d^2/12 is too small by up to a factor of five) and
bounded at standstill. A prediction far outside (Z below about 1e-8) indicates a model error; then R = d^2/12, too.

A filter's state (6,) is x [rad], v [rad/s], the covariance P_xx, P_xv, P_vv, and the last measurement [rad].
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators.slots import slots

F = slots("angle", "velocity", "p_xx", "p_xv", "p_vv", "measured")  # state of one filter
P = slots("acceleration", "quantum", "noise")  # V_a [(rad/s^2)^2], encoder step [rad], R [rad^2]
FASTEST = 10.0  # [rad/s] standard deviation of the velocity at the start
_NARROW, _UNLIKELY = 1e-3, 1e-8  # interval [sd] treated as a point; probability treated as 0


@njit(cache=True, error_model="numpy")
def start(state: Array, angle: float, variance: float, fastest: float) -> None:
    """Overwrite a filter's state (6,): at `angle` [rad] with `variance` [rad^2], velocity 0 +- `fastest` [rad/s]."""
    state[F.angle], state[F.velocity] = angle, 0.0
    state[F.p_xx], state[F.p_xv], state[F.p_vv] = variance, 0.0, fastest * fastest
    state[F.measured] = angle


@njit(cache=True, error_model="numpy")
def predict(state: Array, T: float, V: float) -> None:
    """T [s] later, eq. (53); V = V_a [(rad/s^2)^2]."""
    state[F.angle] += T * state[F.velocity]
    half = 0.5 * T * T
    state[F.p_xx] += T * (2.0 * state[F.p_xv] + T * state[F.p_vv]) + V * half * half
    state[F.p_xv] += T * state[F.p_vv] + V * half * T
    state[F.p_vv] += V * T * T


@njit(cache=True, error_model="numpy")
def _update(state: Array, S: float, shift: float, left: float) -> None:
    """Correct by a measurement with predicted variance S, posterior mean `shift` beyond it and variance left * S."""
    K, L = state[F.p_xx] / S, state[F.p_xv] / S
    state[F.angle] += K * shift
    state[F.velocity] += L * shift
    gone = (1.0 - left) * S
    state[F.p_xx] = max(state[F.p_xx] - gone * K * K, 0.0)
    state[F.p_xv] -= gone * K * L
    state[F.p_vv] = max(state[F.p_vv] - gone * L * L, 0.0)


@njit(cache=True, error_model="numpy")
def correct(state: Array, z: float, R: float) -> None:
    """Update with a measurement z [rad] with white noise of variance R > 0 [rad^2], eq. (54)."""
    S = state[F.p_xx] + R
    _update(state, S, z - state[F.angle], 0.0)


@njit(cache=True, error_model="numpy")
def correct_quantised(state: Array, z: float, quantum: float, R: float) -> None:
    """Update with a measurement z [rad] of an encoder, quantum > 0 [rad], after white noise of variance R [rad^2]."""
    S = state[F.p_xx] + R
    s, away = sqrt(S), z - state[F.angle]
    again, state[F.measured] = z == state[F.measured], z
    if again and abs(away) <= 0.5 * quantum and quantum * quantum / 12.0 >= S:
        return
    if not quantum > _NARROW * s:
        correct(state, z, R + quantum * quantum / 12.0)
        return
    side = 1.0 if away >= 0.0 else -1.0  # mirrored to positive arguments, where erfc is accurate
    a, b = (side * away - 0.5 * quantum) / s, (side * away + 0.5 * quantum) / s
    Z = 0.5 * (erfc(a / sqrt(2.0)) - erfc(b / sqrt(2.0)))
    if not Z > _UNLIKELY:
        correct(state, z, R + quantum * quantum / 12.0)
        return
    fa, fb = exp(-0.5 * a * a) / sqrt(2.0 * pi), exp(-0.5 * b * b) / sqrt(2.0 * pi)
    e = (fa - fb) / Z
    left = min(max(1.0 + (a * fa - b * fb) / Z - e * e, 0.0), 1.0)
    _update(state, S, side * s * e, left)


def parameter_row(parameters: Any) -> Array:
    """The row of slots P from an estimator's parameters."""
    return np.array([parameters.acceleration**2, parameters.quantum, parameters.position_noise**2])


@njit(cache=True, error_model="numpy", forceinline=True)
def follow(par: Array, filters: Array, sample: Array, elapsed: float, restarted: bool) -> None:
    """Advance filters (1 + m, F.size) of q and thetas by `elapsed` [s] to sample (time, q, theta_1, tau_1, ..)."""
    for i in range(filters.shape[0]):
        measured = sample[1] if i == 0 else sample[2 * i]
        if restarted:
            start(filters[i], measured, par[P.noise] + par[P.quantum] ** 2 / 12.0, FASTEST)
            continue
        predict(filters[i], elapsed, par[P.acceleration])
        if par[P.quantum] > 0.0:
            correct_quantised(filters[i], measured, par[P.quantum], par[P.noise])
        else:
            correct(filters[i], measured, par[P.noise])
