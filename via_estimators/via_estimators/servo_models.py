"""Least squares for a link whose servo has uncertain numbers: one Kalman filter per servo, mixed by likelihood.

Source: D. T. Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Transactions on Automatic
Control 10(4), 1965: of K models one holds, each has a filter, and the estimate is their mean, weighted by likelihood.

Model j is a position servo with bandwidth w_j, dead time T_j and speed limit v_j (via_core.servos). Its angle gives the
spring torque, and one equation per row,

    y = row_j' x + e,    variance of e = noise_j within + beside

in the same unknowns x. Unknowns may change, so they forget: in the time dt their covariance returns to that of the
prior, P <- K P K + (1 - K^2), K = exp(-dt / memory) per unknown. One row costs, for each model,

    1. prediction   P as above
    2. correction   Kalman's gain for the variance `overlap` (noise_j within + beside), since rows overlap
    3. noise        mean of (v^2 - row' P row - beside) / within, v the innovation
    4. likelihood   l_j <- exp(-dt / persistence) l_j - (log S_j + v^2 / S_j) / (2 overlap), S_j the variance of v

Its weight is prior_j exp(l_j). Servos that cannot be distinguished (a speed limit in slow motion) keep their weights,
and the difference of their estimates is part of the covariance.

Unknowns are scaled so that the prior is x = 0, P = 1. One bank's state is a flat row; `size` defines its layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import e, exp, isfinite, log

import numpy as np
from numba import njit
from via_core.servos import limited_step
from via_core.signals import Array

from via_estimators.slots import slots

SERVO = slots("bandwidth", "dead_time", "speed_limit", "log_prior")  # columns of the table (K, 4) of models
MOTION = slots("angle", "velocity", "preset", "preset_velocity")  # of both servos of a model
FILTER = slots("likelihood", "noise", "equations", "weight")  # of a model; then x (n,), P (n, n)
HEAD = slots("taken", "time")
UNCERTAIN = 1.0  # equations that the declared noise counts for
LEAST_NOISE = 1e-8  # of the declared variance


@dataclass(frozen=True)
class Servos:
    """Servos around one of a device file: factors on its bandwidth with changes of its dead time, and on its speed.

    Bandwidth and dead time come in pairs, since a lag of 2 / w and a dead time have almost the same effect.
    """

    # factor on w; change of the dead time, over itself or 1 / w if that is longer
    lags: tuple[tuple[float, float], ...] = (
        (1.5, 0.6), (1.5, 0.0), (1.0, 0.0), (0.7, 0.0), (0.5, 0.0), (1.0, -0.7), (0.6, -0.7), (1.0, 0.8)
    )  # fmt: skip
    speeds: tuple[float, ...] = (0.35, 0.5, 0.7, 1.0, 4.0)
    tolerance: float = 0.3  # standard deviation of the logarithms of factors and of the change, before any data

    def around(self, bandwidth: float, dead_time: float, speed_limit: float) -> Array:
        """The table (K, 4) of SERVO, of increasing dead time.

        speed_limit  [rad/s]; 0 if unknown: the speeds are then around that which a servo reaches in a step of 1 rad,
                     bandwidth / e, and equally probable
        """
        reference, certainty = (speed_limit, 1.0) if speed_limit > 0.0 else (bandwidth / e, 0.0)
        rows = [
            (
                factor * bandwidth,
                max(dead_time + change * max(dead_time, 1.0 / bandwidth), 0.0),
                speed * reference,
                -0.5 * (log(factor) ** 2 + change**2 + certainty * log(speed) ** 2) / self.tolerance**2,
            )
            for factor, change in sorted(self.lags, key=lambda lag: lag[1])
            for speed in self.speeds
        ]
        table = np.array(rows)
        table[:, SERVO.log_prior] -= log(np.sum(np.exp(table[:, SERVO.log_prior])))
        return table


@njit(cache=True, error_model="numpy", inline="always")
def size(models: int, n: int) -> int:
    """Floats in the state of a bank: HEAD, combined mean and covariance, then MOTION, FILTER, x and P of each model."""
    return HEAD.size + n + n * n + models * (MOTION.size + FILTER.size + n + n * n)


@njit(cache=True, error_model="numpy", inline="always")
def estimate_of(state: Array, n: int) -> tuple[Array, Array]:
    """The views mean (n,) and covariance (n, n) of the combined estimate at the time of the last equation."""
    return state[HEAD.size : HEAD.size + n], state[HEAD.size + n : HEAD.size + n + n * n].reshape(n, n)


@njit(cache=True, error_model="numpy", inline="always")
def motions_of(state: Array, models: int, n: int) -> Array:
    """The view (K, 4) of MOTION."""
    at = HEAD.size + n + n * n
    return state[at : at + models * MOTION.size].reshape(models, MOTION.size)


@njit(cache=True, error_model="numpy", inline="always")
def filters_of(state: Array, models: int, n: int) -> Array:
    """The view (K, 4 + n + n^2) of FILTER, x and P."""
    at = HEAD.size + n + n * n + models * MOTION.size
    return state[at:].reshape(models, FILTER.size + n + n * n)


@njit(cache=True, error_model="numpy")
def start(state: Array, table: Array, n: int) -> None:
    """Overwrite the state with the prior."""
    state[:] = 0.0
    filters = filters_of(state, len(table), n)
    filters[:, FILTER.noise] = 1.0
    filters[:, FILTER.equations] = UNCERTAIN
    filters[:, FILTER.weight] = np.exp(table[:, SERVO.log_prior])
    for i in range(n):
        filters[:, FILTER.size + n + i * (n + 1)] = 1.0
        estimate_of(state, n)[1][i, i] = 1.0


@njit(cache=True, error_model="numpy", inline="always")
def follow(motion: Array, servo: Array, command: float, preset: float, step: float) -> None:
    """Advance both servos of a model by `step` [s]; a command that is not finite leaves its servo to the last one.

    A preset is not a number before its first command: it is where the command wants it, since it was never seen.
    """
    w, limit = servo[SERVO.bandwidth], servo[SERVO.speed_limit]
    x, v = motion[MOTION.angle], motion[MOTION.velocity]
    motion[MOTION.angle], motion[MOTION.velocity] = limited_step(x, v, command, w, limit, step)
    x, v = motion[MOTION.preset], motion[MOTION.preset_velocity]
    if not isfinite(x):
        x, v = preset, 0.0
    motion[MOTION.preset], motion[MOTION.preset_velocity] = limited_step(x, v, preset, w, limit, step)


@njit(cache=True, error_model="numpy", inline="always")
def forget(P: Array, elapsed: float, memory: Array) -> None:
    """Return the covariance P (n, n) towards that of the prior, 1."""
    for i in range(memory.size):
        for k in range(memory.size):
            P[i, k] *= exp(-elapsed / memory[i] - elapsed / memory[k])
        P[i, i] += 1.0 - exp(-2.0 * elapsed / memory[i])


@njit(cache=True, error_model="numpy", inline="always")
def _combine(state: Array, models: int, n: int) -> None:
    """Mean and covariance of the mixture of all models."""
    filters = filters_of(state, models, n)
    mean, covariance = estimate_of(state, n)
    mean[:], covariance[:, :] = 0.0, 0.0
    for j in range(models):
        for i in range(n):
            mean[i] += filters[j, FILTER.weight] * filters[j, FILTER.size + i]
    for j in range(models):
        x, P = filters[j, FILTER.size : FILTER.size + n], filters[j, FILTER.size + n :].reshape(n, n)
        for i in range(n):
            for k in range(n):
                covariance[i, k] += filters[j, FILTER.weight] * (P[i, k] + (x[i] - mean[i]) * (x[k] - mean[k]))


@njit(cache=True, error_model="numpy")
def take(
    state: Array, table: Array, time: float, memory: Array, persistence: float, row: Array, own: int, each: Array,
    width: float, middle: float, y: float, variances: Array, gain: Array,
) -> None:  # fmt: skip
    """One step to `time` [s] with the equations row_j' x = y.

    memory       [s] (n,) of the unknowns
    persistence  [s] of the likelihood
    row          (n,), overwritten; the same for all models except in column `own`
    each         (K,) what model j multiplies with the unknown `own`, middle + width x
    variances    within, beside and overlap
    gain         (n,), overwritten
    """
    n, within, beside, overlap = row.size, variances[0], variances[1], variances[2]
    elapsed = max(time - state[HEAD.time], 0.0) if state[HEAD.taken] > 0.0 else 0.0
    stay, highest, total = exp(-elapsed / persistence), -np.inf, 0.0
    filters = filters_of(state, len(table), n)
    for j in range(len(table)):
        own_filter = filters[j]
        x, P = own_filter[FILTER.size : FILTER.size + n], own_filter[FILTER.size + n :].reshape(n, n)
        row[own] = width * each[j]
        forget(P, elapsed, memory)
        innovation, doubt = y - middle * each[j], 0.0
        for i in range(n):
            gain[i] = 0.0
            for k in range(n):
                gain[i] += P[i, k] * row[k]
            innovation -= row[i] * x[i]
            doubt += row[i] * gain[i]
        error = own_filter[FILTER.noise] * within + beside
        variance = doubt + error
        square = innovation * innovation
        own_filter[FILTER.likelihood] = stay * own_filter[FILTER.likelihood] - 0.5 / overlap * (
            square / variance + log(variance / within)
        )
        share = (error / variance) ** 2 / overlap
        own_filter[FILTER.equations] = UNCERTAIN + stay * (own_filter[FILTER.equations] - UNCERTAIN) + share
        own_filter[FILTER.noise] = max(
            own_filter[FILTER.noise] + (square - variance) / within * share / own_filter[FILTER.equations], LEAST_NOISE
        )
        for i in range(n):
            x[i] += gain[i] * innovation / (doubt + overlap * error)
        for i in range(n):
            for k in range(n):
                P[i, k] -= gain[i] * gain[k] / (doubt + overlap * error)
        highest = max(highest, own_filter[FILTER.likelihood] + table[j, SERVO.log_prior])
    for j in range(len(table)):
        filters[j, FILTER.weight] = exp(filters[j, FILTER.likelihood] + table[j, SERVO.log_prior] - highest)
        total += filters[j, FILTER.weight]
    filters[:, FILTER.weight] /= total
    state[HEAD.taken] += 1.0
    state[HEAD.time] = time
    _combine(state, len(table), n)
