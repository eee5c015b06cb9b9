"""Extended Kalman filter of each motor with its parameters among the states, a peer of the other estimators.

Source: A. Gelb (ed.), Applied Optimal Estimation, MIT Press 1974, Table 6.1-1 in discrete time, as in D. Simon, Optimal
State Estimation, Wiley 2006, eqs. (13.46), (13.47) and Section 13.4, parameter estimation:

    x <- f(x, u),    P <- F P F' + Q,    F = df/dx at the last estimate

f is `motor_model.advance`; `motor_kalman` has Q, the correction and the report. L. Ljung, Asymptotic behavior of the
extended Kalman filter as a parameter estimator for linear systems, IEEE Transactions on Automatic Control 24(1), 1979,
shows that such a filter can be biased or diverge: its gain does not contain how it depends on the parameters. So its
standard deviations are those of the first order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import motor_kalman
from via_estimators.contract import Kernel
from via_estimators.motor_kalman import MotorKalman, MotorKalmanParameters, P
from via_estimators.motor_model import INPUT, X, derivatives
from via_estimators.transmissions import JOINT


@dataclass(frozen=True)
class ExtendedKalmanParameters(MotorKalmanParameters):
    """Parameters of `ExtendedKalman`."""


@dataclass(frozen=True)
class ExtendedKalman(MotorKalman):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    kind: ClassVar[type[MotorKalmanParameters]] = ExtendedKalmanParameters
    parameters: MotorKalmanParameters = ExtendedKalmanParameters()

    @cached_property
    def _advance(self) -> Kernel:
        return partial(_advance, self._constants)


@njit(cache=True, error_model="numpy")
def predict(model: Array, x: Array, covariance: Array, given: Array, work: Array, of: Array) -> None:
    """x <- f(x), P <- F P F' over one time step; only the rows of angle and velocity of F differ from the unit matrix.

    work (4, n), of (4, n) are overwritten: rows of F, then those of F P
    """
    n = x.size
    x[X.angle], x[X.velocity] = derivatives(model, x, given, work, of[:2])
    for i in range(2):
        for k in range(n):
            total = 0.0
            for j in range(n):
                total += of[i, j] * covariance[j, k]
            of[2 + i, k] = total
    aa = av = vv = 0.0
    for k in range(n):
        aa += of[2, k] * of[0, k]
        av += of[2, k] * of[1, k]
        vv += of[3, k] * of[1, k]
    for k in range(X.velocity + 1, n):
        covariance[X.angle, k] = covariance[k, X.angle] = of[2, k]
        covariance[X.velocity, k] = covariance[k, X.velocity] = of[3, k]
    covariance[X.angle, X.angle], covariance[X.velocity, X.velocity] = aa, vv
    covariance[X.angle, X.velocity] = covariance[X.velocity, X.angle] = av


@njit(cache=True, error_model="numpy")
def _advance(par: Array, state: Array, rows: Array, out: Array) -> int:
    n, model, m = motor_kalman.size_of(par), par[P.order : P.size], int(par[P.transmissions])
    given, work, of = np.empty(INPUT.size), np.empty((4, n)), np.empty((4, n))
    joint = np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        if not motor_kalman.enter(par, state, rows[k], joint, out[k]):
            continue
        for i in range(m):
            x, covariance, pieces = motor_kalman.begin(par, state, rows[k], i, joint, given)
            for _ in range(pieces):
                variance = motor_kalman.noise_of(par, x, covariance, given, pieces, work)
                predict(model, x, covariance, given, work, of)
                motor_kalman.move_on(par, x, covariance, given, variance, work)
            motor_kalman.end(par, state, rows[k], i, pieces, joint, work)
        motor_kalman.finish(par, state, rows[k], joint, out[k])
    return int(out[-1, 1])
