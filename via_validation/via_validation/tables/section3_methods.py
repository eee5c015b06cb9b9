"""Estimators of Section 3 as printed and as corrected, and their errors over noise realisations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import factorial, sqrt

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.springs import SinhSpring
from via_core.weak_form import modulating
from via_estimators import rls
from via_estimators.contract import Estimator
from via_estimators.modulated_stiffness import ModulatedStiffness, ModulatedStiffnessParameters
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters

from via_validation.tables import modulating_errors as errors
from via_validation.tables.cubic_joint import DAMPING, INERTIA, TAU, THETA, TORQUE_RATIO, Log, cubic_log
from via_validation.tables.errors import mse, msrep


def differentiated(order: int, log: Log, stride: int = 1, span: float = 0.5) -> ModulatedStiffness:
    """Section 3's estimator with the document's settings (3.4) and the true torque noise."""
    return ModulatedStiffness(
        ModulatedStiffnessParameters(
            taylor_order=order,
            window=round(span * 1000.0 / stride),
            sampling=1e-3 * stride,
            torque_noise=log.noise_sd(TAU, TORQUE_RATIO),
            position_noise=0.0,
            stiffness_deviation=100.0,
            deflection_scale=2.0,
            motor_inertia_1=INERTIA,
            motor_inertia_2=INERTIA,
            motor_damping_1=DAMPING,
            motor_damping_2=DAMPING,
        )
    )


def undifferentiated(order: int, log: Log, even: bool = False) -> ModulatedTorque:
    """The default estimator with T = .2 s; a stiffness polynomial of order N has N / 2 + 1 odd terms of torque."""
    return ModulatedTorque(
        ModulatedTorqueParameters(
            order=order // 2 + 1,
            even_terms=order // 2 + 1 if even else 0,
            stiffness_deviation=1e5 if even else 300.0,  # this prior is too wide to keep even terms small
            truncation=0.0,
            memory=1e9,
            deflection_scale=2.0,
            torque_noise=log.noise_sd(TAU, TORQUE_RATIO),
            position_noise=0.0,
        )
    )


@dataclass(frozen=True)
class Outcome:
    """Means over noise realisations."""

    mse: float
    msrep: float
    ratio: float  # reported over empirical standard deviation [-]


@cache
def with_torque_noise(method: str, order: int, case: str, seeds: int) -> Outcome:
    """Outcome of 'differentiated' or 'undifferentiated' with Table 2's noise on torques."""
    log = cubic_log(case)
    estimator = differentiated(order, log) if method == "differentiated" else undifferentiated(order, log)
    return outcome(estimator, log, seeds, log.noise_sd(TAU, TORQUE_RATIO))


def outcome(estimator: Estimator, log: Log, seeds: int, torque: float, position: float = 0.0) -> Outcome:
    """Errors and consistency of the standard deviation over `seeds` noise realisations; noise sd [N m], [rad]."""
    later, found, squares, variances = log.later, [], 0.0, 0.0
    for seed in range(seeds):
        value, sd = estimator.run_rows(log.noisy(seed, torque, position))[1].column("stiffness")
        found.append((mse(log.stiffness[later], value[later]), msrep(log.stiffness[later], value[later])))
        squares += float(np.mean((value - log.stiffness)[later] ** 2))
        variances += float(np.mean(sd[later] ** 2))
    average = np.mean(found, axis=0)
    return Outcome(float(average[0]), float(average[1]), sqrt(variances / squares))


@njit(cache=True, error_model="numpy")
def _recursion(gamma: Array, y: Array, prior: float, found: Array) -> None:
    """Write the coefficients found (n, k) after each of the rows gamma (n, k), from zero and P(0) = prior."""
    k = gamma.shape[1]
    P, w, gain = np.empty((k, k)), np.empty(k), np.empty(k)
    rls.start(P, w, prior)
    for row in range(y.size):
        rls.update(P, w, gamma[row], y[row], 1.0, gain)
        found[row] = w


def as_printed(log: Log, backwards: bool, filled: bool, order: int = 2, size: int = 500) -> Array:
    """Device stiffness (n,) by plain trapezoids and RLS on P, as printed or corrected.

    backwards  sample k - m has the weight at m/H, as printed in (26), (27); else sample k - H + m (correct)
    filled     samples before the first are zero, as below (27); else there is no estimate before a full window
    """
    span, u = size * 1e-3, np.arange(size + 1) / size
    W = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size
    weights = [W * span ** (3 - i) * modulating(3, i, u) for i in (1, 2, 3)]
    kernels = weights if backwards else [w[::-1] for w in weights]  # np.convolve pairs kernel[m] with sample k - m
    padding = size if filled else 0
    total = np.zeros(len(log.rows))
    for theta, tau in zip(THETA, TAU, strict=True):
        q, angle, held = (np.concatenate([np.zeros(padding), log.rows[:, c]]) for c in (1, theta, tau))
        torque = 0.5 * (held + np.append(held[1:], held[-1]))  # mean at the stamp, since the trapezoid needs samples
        phi = q - angle
        fir = [np.convolve(signal, kernels[i], "valid") for signal, i in ((angle, 2), (angle, 1), (torque, 0))]
        y = INERTIA * fir[0] - DAMPING * fir[1] - fir[2]
        powers = [phi ** (j + 1) / factorial(j + 1) for j in range(order + 1)]
        gamma = np.stack([np.convolve(p, kernels[0], "valid") for p in powers], axis=1)
        alpha = np.zeros_like(gamma)
        _recursion(gamma, y, 1e8, alpha)
        at = phi[-len(alpha) :]
        total[-len(alpha) :] += sum(alpha[:, j] * at**j / factorial(j) for j in range(order + 1))
    return total


def naive_ratio(log: Log, seeds: int, torque: float, order: int = 2) -> float:
    """Standard deviation by sigma^2 P, for independent residuals, over the scatter; least squares over all rows."""
    size, later = 500, log.later
    kernel = 0.25 / size * modulating(3, 1, np.arange(size + 1) / size)[::-1]
    bend, third = (0.5 ** (3 - i) / size * modulating(3, i, np.arange(size + 1) / size)[::-1] for i in (2, 3))
    third[[0, -1]] *= 0.5
    phi = log.rows[:, 1] - log.rows[:, 2]
    powers = np.stack([phi**j / factorial(j) for j in range(order + 1)], axis=1)
    gamma = np.stack([np.convolve(powers[:, j] * phi / (j + 1), kernel, "valid") for j in range(order + 1)], axis=1)
    P = np.linalg.inv(gamma.T @ gamma)
    pull = powers[later] @ P @ gamma.T
    width = np.sqrt(np.einsum("ij,jk,ik->i", powers[later], P, powers[later]))
    clean = INERTIA * np.convolve(log.rows[:, 2], third, "valid") - DAMPING * np.convolve(log.rows[:, 2], bend, "valid")
    found, reported = [], []
    for seed in range(seeds):
        y = clean - np.convolve(log.noisy(seed, torque)[:, 3], kernel, "valid")
        alpha = P @ (gamma.T @ y)
        found.append(pull @ y)
        reported.append(sqrt(float(np.mean((y - gamma @ alpha) ** 2))) * width)
    return float(np.sqrt(np.mean(np.square(reported)) / np.mean(np.var(found, axis=0))))


def noise(span: float, intervals: int) -> float:
    """Standard deviation of a row for 1 N m of noise, as a rate of torque [N m/s]."""
    return errors.noise_deviation(1.0, intervals, span)


def truncation(order: int, span: float, period: int = 1) -> float:
    """Largest error of a row, as a rate of torque [N m/s], from truncating a sinh spring's Taylor series at order N."""
    spring, alpha = SinhSpring(3.0, 1.0, 1.5), [1.5, 0.0, 3.375, 0.0, 7.59375]
    phi = 1.8 * np.sin(2.0 * np.pi * 1e-3 * np.arange(0, 4000, period))
    rho = errors.remainder(spring, alpha[: order + 1], phi)
    found = errors.truncation_errors(rho, round(span * 1000.0 / period), span)
    return float(np.abs(found).max()) / errors.row_scale(span)


def trapezoid_inertia(log: Log, order: int, size: int = 200, terms: int = 5) -> float:
    """Inertia [kg m^2] of motor 1 by batch least squares on undifferentiated rows, with corrected weights of (24)."""
    u = np.arange(size + 1) / size
    W = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size
    kernels = [(W * modulating(order, i, u) * (1e-3 * size) ** (2 - i))[::-1] for i in range(3)]
    q, theta, held = log.rows[:, 1:4].T
    torque = 0.5 * (held + np.append(held[1:], held[-1]))  # mean at the stamp, since the trapezoid needs samples
    columns = [np.convolve(theta, kernels[2], "valid"), -np.convolve(theta, kernels[1], "valid")]
    columns += [-np.convolve((q - theta) ** (2 * p + 1), kernels[0], "valid") for p in range(terms)]
    regressors = np.stack(columns, axis=1)
    scale = np.abs(regressors).max(axis=0)
    found = np.linalg.lstsq(regressors / scale, np.convolve(torque, kernels[0], "valid"), rcond=None)[0]
    return float(found[0] / scale[0])
