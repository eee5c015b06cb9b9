"""Unscented Kalman filter of each motor with its parameters among the states, a peer of the other estimators.

Source: S. J. Julier and J. K. Uhlmann, Unscented filtering and nonlinear estimation, Proceedings of the IEEE 92(3),
2004, eq. (12): the symmetric set of 2 n sigma points with equal weights,

    P = L L',    chi_j = x +- sqrt(n) L e_j,    x <- mean of f(chi_j),    P <- mean of (f(chi_j) - x)(..)' + Q

E. A. Wan and R. van der Merwe, The unscented Kalman filter for nonlinear estimation, 2000, Section 4, use it for the
parameters too. Weights are positive, so P remains positive semidefinite whatever f is. (With these points, this is also
the cubature Kalman filter.) f is `motor_model.advance`; `motor_kalman` has Q, the correction, which is linear and
hence needs no sigma points, and the report.

Only angle and velocity change in a step. The parameters' block of P stays, and their covariance with a moved state y is
the mean over pairs of points: sum_j L_kj (y(chi_j+) - y(chi_j-)) sqrt(n) / (2 n).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from math import sqrt
from typing import ClassVar

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import motor_kalman
from via_estimators.contract import Kernel
from via_estimators.motor_kalman import MotorKalman, MotorKalmanParameters, P
from via_estimators.motor_model import INPUT, X, advance
from via_estimators.transmissions import JOINT

_ROUNDING = 1e-14  # of a variance: what rounding leaves of a pivot that is zero


@dataclass(frozen=True)
class UnscentedKalmanParameters(MotorKalmanParameters):
    """Parameters of `UnscentedKalman`."""


@dataclass(frozen=True)
class UnscentedKalman(MotorKalman):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    kind: ClassVar[type[MotorKalmanParameters]] = UnscentedKalmanParameters
    parameters: MotorKalmanParameters = UnscentedKalmanParameters()

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def root_of(covariance: Array, L: Array) -> None:
    """Lower triangular L (n, n) with L L' = P; the column of a pivot that is zero or less, by rounding, is zero."""
    n = covariance.shape[0]
    for j in range(n):
        pivot = covariance[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        own = sqrt(pivot) if pivot > _ROUNDING * covariance[j, j] else 0.0
        for i in range(j):
            L[i, j] = 0.0
        L[j, j] = own
        for i in range(j + 1, n):
            total = covariance[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / own if own > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def predict(model: Array, x: Array, covariance: Array, given: Array, work: Array, points: Array) -> None:
    """x and P over one time step, without Q; work (4, n) and points (n + 5, n) are overwritten."""
    n = x.size
    L, point, moved = points[:n], points[n], points[n + 1 : n + 5].reshape(2, 2, n)  # (sign, state, column)
    root_of(covariance, L)
    reach, angle, velocity = sqrt(n), 0.0, 0.0
    for side in range(2):
        step = reach if side == 0 else -reach
        for j in range(n):
            for k in range(n):
                point[k] = x[k] + step * L[k, j]
            moved[side, 0, j], moved[side, 1, j] = advance(model, point, given, work)
            angle += moved[side, 0, j]
            velocity += moved[side, 1, j]
    x[X.angle], x[X.velocity] = angle / (2 * n), velocity / (2 * n)
    aa = av = vv = 0.0
    for side in range(2):
        for j in range(n):
            a, v = moved[side, 0, j] - x[X.angle], moved[side, 1, j] - x[X.velocity]
            aa += a * a
            av += a * v
            vv += v * v
    for k in range(X.velocity + 1, n):
        with_angle = with_velocity = 0.0
        for j in range(k + 1):
            with_angle += L[k, j] * (moved[0, 0, j] - moved[1, 0, j])
            with_velocity += L[k, j] * (moved[0, 1, j] - moved[1, 1, j])
        covariance[X.angle, k] = covariance[k, X.angle] = reach * with_angle / (2 * n)
        covariance[X.velocity, k] = covariance[k, X.velocity] = reach * with_velocity / (2 * n)
    covariance[X.angle, X.angle], covariance[X.velocity, X.velocity] = aa / (2 * n), vv / (2 * n)
    covariance[X.angle, X.velocity] = covariance[X.velocity, X.angle] = av / (2 * n)


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    n, model, m = motor_kalman.size_of(par), par[P.order : P.size], int(par[P.transmissions])
    given, work, points = np.empty(INPUT.size), np.empty((4, n)), np.empty((n + 5, n))
    joint = np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        if not motor_kalman.enter(par, state, rows[k], joint, out[k]):
            continue
        for i in range(m):
            x, covariance, pieces = motor_kalman.begin(par, state, rows[k], i, joint, given)
            for _ in range(pieces):
                variance = motor_kalman.noise_of(par, x, covariance, given, pieces, work)
                predict(model, x, covariance, given, work, points)
                motor_kalman.move_on(par, x, covariance, given, variance, work)
            motor_kalman.end(par, state, rows[k], i, pieces, joint, work)
        motor_kalman.finish(par, state, rows[k], joint, out[k])
    return int(out[-1, 1])
