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
from math import sqrt
from typing import ClassVar

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import motor_kalman, transmissions, window
from via_estimators.contract import Kernel
from via_estimators.motor_kalman import FURTHEST, KEPT, ROW, MotorKalman, MotorKalmanParameters, P
from via_estimators.motor_model import INPUT, X, add_noise, derivatives, noise
from via_estimators.transmissions import JOINT
from via_estimators.window import HEADER


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
    n = X.size + int(par[P.order]) + int(par[P.even_terms])
    model, far = par[P.order : P.size], FURTHEST * par[P.deflection_scale]
    last, times, ring, parts = motor_kalman.views(par, state)
    m = parts.shape[0]
    value, sd = window.outputs(state, 1 + 3 * m)
    given, work, of = np.empty(INPUT.size), np.empty((4, n)), np.empty((4, n))
    joint = np.empty(JOINT.size)
    for k in range(rows.shape[0]):
        if transmissions.enter(state, times, rows[k], 2, far, par[P.max_gap]) == window.SKIPPED:
            window.answer(state, BAD_SAMPLE, out[k])
            continue
        full, slot = state[HEADER.filled] == times.size, int(state[HEADER.slot])
        elapsed = max(rows[k, 0] - last[ROW.time], 0.0) if state[HEADER.samples] > 1.0 else 0.0
        transmissions.begin(joint)
        for i in range(m):
            kept, x, covariance = motor_kalman.filter_of(parts[i], n)
            theta = rows[k, 2 + 2 * i]
            ring[i, slot] = phi = rows[k, 1] - theta
            moved = window.span_of(ring[i]) if full else 0.0
            joint[JOINT.motion] = min(joint[JOINT.motion], moved)
            moving = full and moved >= par[P.minimum_motion]
            motor_kalman.age(par, x, covariance, elapsed)
            if moving and kept[KEPT.running] > 0.0:
                pieces = motor_kalman.divide(rows[k], i, last, given)
                torque_noise = sqrt(pieces) * par[P.torque_noise]
                for _ in range(pieces):
                    variance = noise(model, x, covariance, given, torque_noise, par[P.position_noise], work)
                    predict(model, x, covariance, given, work, of)
                    add_noise(model, x, given[INPUT.step], variance, work, covariance)
                    motor_kalman.next_piece(given)
                motor_kalman.take(par, kept, x, covariance, rows[k], i, of[0])
            else:
                motor_kalman.restart_motion(par, x, covariance, theta)
            kept[KEPT.running] = 1.0 if moving else 0.0
            motor_kalman.report(par, kept, x, covariance, phi, i, moving, value, sd, joint, work)
        last[ROW.time], last[ROW.q] = rows[k, 0], rows[k, 1]
        transmissions.finish(joint, state, value, sd, out[k])
    return int(out[-1, 1])
