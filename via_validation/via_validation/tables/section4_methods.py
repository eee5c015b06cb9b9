"""Estimators of Section 4, and their errors: ideal and noisy VSA-II, noisy cubic joint, and a hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import log

import numpy as np
from numba import njit
from via_core.signals import Array
from via_core.status import Status
from via_estimators.contract import Estimator
from via_estimators.filtered_signal_based import FilteredSignalBased, FilteredSignalBasedParameters
from via_estimators.qr import rotate_in, solve_triangular
from via_estimators.residual import Residual, ResidualParameters
from via_estimators.signal_based import SignalBased, SignalBasedParameters

from via_validation.tables.batch import BatchLaw, batch_law, integral_rows
from via_validation.tables.cubic_joint import POSITION_RATIO, TAU, THETA, TORQUE_RATIO, cubic_log
from via_validation.tables.errors import mse, msrep
from via_validation.tables.vsa2 import DAMPING, INERTIA, PERIOD, QUANTUM, TORQUE_NOISE, Motion, held, motion, nominal

MM = 1e3  # N mm per N m
FROM = 2000  # first sample at which errors count


@dataclass(frozen=True)
class Errors:
    """Errors of the device stiffness, means over seeds, from 5 s and from 2 s on."""

    mse_5: float  # [(N mm/rad)^2]
    mse_2: float
    msrep_5: float  # [%]
    ratio: float  # reported over empirical standard deviation from 5 s on
    inertia: Array  # (seeds, 2) at the end [kg m^2]; NaN if the method does not estimate it
    damping: Array  # (seeds, 2) [N m s/rad]


def qr_rls(forgetting: float = 0.98, torque_noise: float = 1e-9, minimum_motion: float = 0.0) -> SignalBased:
    """Document's settings for one transmission: seven powers, forgetting factor per sample; very wide prior."""
    return SignalBased(
        SignalBasedParameters(
            transmissions=1, basis="powers", terms=7, window=20, memory=-PERIOD / log(forgetting),
            torque_noise=torque_noise, position_noise=0.0, stiffness_deviation=10.0, inertia_deviation=0.1,
            damping_deviation=0.1, minimum_motion=minimum_motion,
        )
    )  # fmt: skip


def smoothed(truncation: float = 1.0, stiffness_deviation: float = 0.3) -> FilteredSignalBased:
    """Section 4.4: W = 1001, order 20, no forgetting; odd powers only, since the spring law is odd."""
    return FilteredSignalBased(
        FilteredSignalBasedParameters(
            window=1000, order=20, basis="odd_powers", terms=4, torque_noise=TORQUE_NOISE, quantum=QUANTUM,
            position_noise=1e-5, deflection_scale=0.9, stiffness_deviation=stiffness_deviation, inertia_deviation=0.1,
            damping_deviation=0.1, truncation=truncation,
        )
    )  # fmt: skip


def residual(variant: str, ideal: bool) -> Residual:
    """Reference [9] with the nominal motor and seven powers; tolerances equal the errors of the nominal motor."""
    motor = nominal(variant)
    parameters = ResidualParameters(
        transmissions=1 if ideal else 2, basis="powers", terms=7, bandwidth=100.0, torque_noise=TORQUE_NOISE,
        deflection_scale=0.9, stiffness_deviation=2.0, inertia=motor.inertia, damping=motor.viscous_friction,
        inertia_tolerance=INERTIA - motor.inertia, damping_tolerance=motor.viscous_friction - DAMPING,
    )  # fmt: skip
    if ideal:
        return Residual(replace(parameters, acceleration=1e3, position_noise=1e-7))
    return Residual(replace(parameters, quantum=QUANTUM, position_noise=1e-5))


@cache
def ideal_estimates(variant: str, drift: float) -> dict[str, Array]:
    """Stiffness of transmission 1 (N,) [N m/rad] by the three methods of Table 3, from ideal signals."""
    run = motion(variant, drift)
    rows = run.ideal()
    found = {
        "qr_rls": qr_rls().run_rows(rows)[1].column("stiffness_1")[0],
        "batch": whole(run).stiffness(run.q - run.theta[:, 0])[0],
        "residual": residual(variant, True).run_rows(rows[:, (0, 1, 2, 4)])[1].column("stiffness_1")[0],
    }
    return found


def whole(run: Motion) -> BatchLaw:
    """Batch least squares over the whole record, transmission 1."""
    return batch_law((run.time, run.q, run.theta[:, 0], run.theta_velocity[:, 0], run.tau[:, 0]), "powers", 7)


def outcome(estimator: Estimator, run: Motion, seeds: int) -> Errors:
    """Errors over the noise realisations 0 .. seeds - 1; at least one."""
    squares, variances, relative, inertia, damping = [], [], [], [], []
    for seed in range(seeds):
        estimates = estimator.run_rows(run.noisy(seed))[1]
        value, sd = estimates.column("stiffness")
        squares.append((value - run.stiffness) ** 2)
        variances.append(sd**2)
        relative.append(msrep(run.stiffness[5000:], value[5000:]))
        if "motor_inertia_1" in estimates.outputs:
            inertia.append([estimates.column(f"motor_inertia_{i}")[0][-1] for i in (1, 2)])
            damping.append([estimates.column(f"motor_damping_{i}")[0][-1] for i in (1, 2)])
    error, variance = np.mean(squares, axis=0), np.mean(variances, axis=0)
    none = np.full((1, 2), np.nan)
    return Errors(
        MM**2 * float(error[5000:].mean()),
        MM**2 * float(error[FROM:].mean()),
        float(np.mean(relative)),
        float(np.sqrt(variance[5000:].mean() / error[5000:].mean())),
        np.array(inertia) if inertia else none,
        np.array(damping) if damping else none,
    )


def cramer_rao(variant: str) -> Array:
    """Cramer-Rao bounds (2,) of the sd of B [kg m^2] and D [N m s/rad], worse motor, for 1 N mm and exact angles.

    The coefficients of four odd powers are unknown too; each sample of the motor equation is one row.
    """
    run, worst = motion(variant), np.zeros(2)
    for i in (0, 1):
        phi, rate = run.q - run.theta[:, i], run.theta_velocity[:, i]
        z = (0.5 * (phi[1:] + phi[:-1]) / np.abs(phi).max())[:, None] ** (2 * np.arange(4) + 1)
        rows = np.column_stack([np.diff(rate) / PERIOD, np.diff(run.theta[:, i]) / PERIOD, z])
        covariance = TORQUE_NOISE**2 * np.linalg.inv(rows.T @ rows)
        worst = np.maximum(worst, np.sqrt(np.diag(covariance)[:2]))
    return worst


@cache
def cubic(seeds: int, case: str) -> tuple[float, float, Array, Array, Array]:
    """Cubic joint: MSE [(N m/rad)^2], MSREP [%], B, D (2,) at the end, estimates (N,) of the first seed."""
    log_ = cubic_log(case)
    torque, position = log_.noise_sd(TAU, TORQUE_RATIO), log_.noise_sd(THETA, POSITION_RATIO)
    estimator = FilteredSignalBased(
        FilteredSignalBasedParameters(
            window=1000, order=20, basis="odd_powers", terms=2, torque_noise=torque, position_noise=position,
            deflection_scale=2.0, stiffness_deviation=300.0, inertia_deviation=0.1, damping_deviation=10.0,
        )
    )  # fmt: skip
    values, inertia, damping = [], [], []
    for seed in range(seeds):
        estimates = estimator.run_rows(log_.noisy(seed, torque, position))[1]
        values.append(estimates.column("stiffness")[0])
        inertia.append([estimates.column(f"motor_inertia_{i}")[0][-1] for i in (1, 2)])
        damping.append([estimates.column(f"motor_damping_{i}")[0][-1] for i in (1, 2)])
    later = log_.later
    squares = float(np.mean([mse(log_.stiffness[later], value[later]) for value in values]))
    relative = float(np.mean([msrep(log_.stiffness[later], value[later]) for value in values]))
    return squares, relative, np.mean(inertia, axis=0), np.mean(damping, axis=0), values[0]


def hold_errors(forgetting: float, variant: str) -> tuple[float, float, bool]:
    """Largest errors [N mm/rad] in a hold of 7 s, ours and plain forgetting; whether its last 5 s are NOT_EXCITED."""
    run = held(variant)
    data = run.ideal()
    data[:, 4] += 1e-6 * np.random.default_rng(1).normal(size=len(data))
    estimates = qr_rls(forgetting, 1e-6, 0.002).run_rows(data)[1]
    truth = run.stiffness_each[:, 0]
    still = run.time >= run.time[-1] - 7.0
    columns, right = integral_rows(data, "powers", 7, 1.0)
    plain = np.empty(len(data))
    _plain_forgetting(columns, right, data[:, 1] - data[:, 2], forgetting**0.5, plain)
    off = np.abs(estimates.column("stiffness_1")[0] - truth)[still]
    lost = np.nan_to_num(np.abs(plain - truth)[still], nan=np.inf)
    marked = np.all(estimates.status[run.time > run.time[-1] - 5.0] == Status.NOT_EXCITED)
    return MM * float(off.max()), MM * float(lost.max()), bool(marked)


@njit(cache=True, error_model="numpy")
def _plain_forgetting(columns: Array, right: Array, phi: Array, root: float, stiffness: Array) -> None:
    """QR-RLS as in 4.1 without leakage; writes the stiffness (N,) from powers of phi after each row."""
    n = columns.shape[1]
    R, p, x = 1e-9 * np.eye(n), np.zeros(n), np.zeros(n)
    for k in range(right.size):
        R *= root
        p *= root
        rotate_in(R, p, columns[k].copy(), right[k], 0)
        solve_triangular(R, p, x)
        total = 0.0
        for j in range(n - 1, 2, -1):
            total = total * phi[k] + x[j]
        stiffness[k] = total
