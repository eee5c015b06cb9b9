"""The Kalman filters of the motor equation compared with filterpy's, and with C++ and Eigen, in one run.

All process the same log of one motor with eight states (angle, velocity, inertia, damping, dry friction, three terms of
the spring law) from the same prior. The results must agree before anything is timed. A filter of filterpy gets our
compiled model, so that its own cost is that of its matrices in numpy. The default estimator gets the same log; its step
also includes standard deviations, status and the check of its samples.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter
from numba import njit
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.signals import Array
from via_estimators import extended_kalman, unscented_kalman
from via_estimators.contract import Live
from via_estimators.methods import estimator_for
from via_estimators.motor_kalman import correct
from via_estimators.motor_model import add_noise, advance, derivatives, noise

from via_validation.bench import eigen
from via_validation.bench.timing import Contender, take_turns
from via_validation.tables.rows import Row

N = 8
ONE_TRANSMISSION = "visco_elastic_demo"
LOG, SLOW = 20_000, 500  # time steps of the log, and of its part for filterpy
SCALE, INERTIA, SLOWEST, TORQUE_NOISE, POSITION_NOISE = 1.0, 0.02, 0.05, 0.05, 1e-4  # [rad, kg m^2, rad/s, N m, rad]
SETTINGS = np.array([SCALE, INERTIA, SLOWEST, TORQUE_NOISE, POSITION_NOISE])
MODEL = np.array([3.0, SCALE, INERTIA, SLOWEST])
START = np.array([0.0, 0.0, 1.0, 0.25, 0.05, 8.0, 10.0, 0.0])
DIAGONAL = np.array([1e-6, 0.1, 0.04, 0.01, 0.01, 25.0, 100.0, 100.0])


def log(count: int, seed: int = 0) -> Array:
    """Rows (count, 5) of a motor's motion: step [s], q before and after [rad], torque [N m], measured angle [rad]."""
    rng, x, work = np.random.default_rng(seed), START.copy(), np.empty((4, N))
    x[2:] *= 1.0 + 0.1 * rng.standard_normal(N - 2)
    t = 1e-3 * np.arange(count + 1)
    q, rows = 0.5 * np.sin(4.0 * t), np.empty((count, 5))
    for k in range(count):
        torque = 2.0 * np.sin(7.0 * t[k]) + np.sin(23.0 * t[k])
        given = np.array([1e-3, q[k], q[k + 1], torque])
        x[:2] = advance(MODEL, x, given, work)
        rows[k, :4], rows[k, 4] = given, x[0] + POSITION_NOISE * rng.standard_normal()
    return rows


@njit(cache=True, error_model="numpy")
def fold_ekf(rows: Array, start: Array, diagonal: Array) -> Array:
    """x (n,) of our extended Kalman filter after rows (N, 5)."""
    n = start.size
    x, P, work, of = start.copy(), np.diag(diagonal), np.empty((4, n)), np.empty((4, n))
    for k in range(rows.shape[0]):
        given = rows[k, :4]
        variance = noise(MODEL, x, P, given, TORQUE_NOISE, POSITION_NOISE, work)
        extended_kalman.predict(MODEL, x, P, given, work, of)
        add_noise(MODEL, x, given[0], variance, work, P)
        correct(x, P, rows[k, 4], POSITION_NOISE**2, of[0])
    return x


@njit(cache=True, error_model="numpy")
def fold_ukf(rows: Array, start: Array, diagonal: Array) -> Array:
    """x (n,) of our unscented Kalman filter after rows (N, 5)."""
    n = start.size
    x, P, work, points = start.copy(), np.diag(diagonal), np.empty((4, n)), np.empty((n + 5, n))
    for k in range(rows.shape[0]):
        given = rows[k, :4]
        variance = noise(MODEL, x, P, given, TORQUE_NOISE, POSITION_NOISE, work)
        unscented_kalman.predict(MODEL, x, P, given, work, points)
        add_noise(MODEL, x, given[0], variance, work, P)
        correct(x, P, rows[k, 4], POSITION_NOISE**2, points[0])
    return x


def _process_noise(x: Array, step: float, variance: float) -> Array:
    """Q (n, n) of filterpy's filters, as in `motor_model.add_noise` at the predicted state."""
    Q = np.zeros((N, N))
    add_noise(MODEL, x, step, variance, np.empty((4, N)), Q)
    return Q


def filterpy_ekf(rows: Array, start: Array, diagonal: Array) -> Array:
    """`fold_ekf` with filterpy."""
    H = np.eye(1, N)
    work, found = np.empty((4, N)), ExtendedKalmanFilter(N, 1)
    found.x, found.P, found.R = start.copy(), np.diag(diagonal), np.array([[POSITION_NOISE**2]])
    for row in rows:
        F = np.eye(N)
        variance = noise(MODEL, found.x, found.P, row[:4], TORQUE_NOISE, POSITION_NOISE, work)
        found.x[:2] = derivatives(MODEL, found.x, row[:4], work, F[:2])
        found.P = F @ found.P @ F.T + _process_noise(found.x, row[0], variance)
        found.update(row[4:], lambda x: H, lambda x: x[:1])
    return np.asarray(found.x)


def filterpy_ukf(rows: Array, start: Array, diagonal: Array) -> Array:
    """`fold_ukf` with filterpy; it corrects by sigma points, which is the same for a linear measurement."""
    work = np.empty((4, N))

    def moved(x: Array, dt: float, given: Array) -> Array:
        return np.array([*advance(MODEL, x, given, work), *x[2:]])

    found = UnscentedKalmanFilter(N, 1, 1e-3, lambda x: x[:1], moved, JulierSigmaPoints(N, kappa=0.0))
    found.x, found.P, found.R = start.copy(), np.diag(diagonal), np.array([[POSITION_NOISE**2]])
    for row in rows:
        variance = noise(MODEL, found.x, found.P, row[:4], TORQUE_NOISE, POSITION_NOISE, work)
        found.Q = np.zeros((N, N))
        found.predict(given=row[:4])
        found.P = found.P + _process_noise(found.x, row[0], variance)
        found.sigmas_f = found.points_fn.sigma_points(found.x, found.P)
        found.update(row[4:])
    return np.asarray(found.x)


def default_contenders(rows: Array) -> dict[str, Contender]:
    """Full steps of the default estimator with one transmission on a log: folded, and in place as in a node."""
    estimator = estimator_for(load_device(ONE_TRANSMISSION))
    samples = np.column_stack([1e-3 * np.arange(1.0, len(rows) + 1.0), rows[:, 2], rows[:, 4], rows[:, 3]])
    begin, fed = len(rows) // 4, Live(estimator)
    state, _ = estimator.run_rows(samples[:begin])
    for row in samples[:begin]:
        fed.take(row[None])
    block = samples[begin : begin + SLOW, None, :].copy()

    def live() -> None:
        for row in block:
            fed.take(row)
        block[:, 0, 0] += 1e-3 * SLOW  # stamps must increase

    later = samples[begin:]
    return {
        "default": Contender(len(later), lambda: estimator.run_rows(later, state)),
        "default_live": Contender(SLOW, live),
    }


def kalman_rows(turns: int) -> list[Row]:
    """Rows of the times per time step and of their ratios."""
    rows = log(LOG)
    few = rows[:SLOW].copy()
    given = (START, DIAGONAL)
    with tempfile.TemporaryDirectory() as folder:
        reference = eigen.build(Path(folder))
        contenders = {
            "ekf": Contender(LOG, partial(fold_ekf, rows, *given)),
            "ukf": Contender(LOG, partial(fold_ukf, rows, *given)),
            "ekf_filterpy": Contender(SLOW, partial(filterpy_ekf, few, *given)),
            "ukf_filterpy": Contender(SLOW, partial(filterpy_ukf, few, *given)),
            **default_contenders(rows),
        }
        agreeing = [("ekf", filterpy_ekf(few, *given)), ("ukf", filterpy_ukf(few, *given))]
        if isinstance(reference, eigen.Reference):
            contenders["ekf_eigen"] = Contender(LOG, partial(reference.ekf, rows, *given, SETTINGS))
            agreeing.append(("ekf", reference.ekf(few, *given, SETTINGS)))
        expected = {"ekf": fold_ekf(few, *given), "ukf": fold_ukf(few, *given)}
        for name, state in agreeing:
            if not np.allclose(state, expected[name], rtol=1e-5, atol=1e-6):
                raise ViaError(f"contenders of {name} disagree: {state} and {expected[name]}")
        times = take_turns(contenders, turns)
    settings = f"n = {N}, one motor, median of {turns} alternating turns, one thread"
    what = {
        "ekf": "our extended Kalman filter over a log", "ukf": "our unscented Kalman filter over a log",
        "ekf_filterpy": "filterpy's extended Kalman filter", "ukf_filterpy": "filterpy's unscented Kalman filter",
        "ekf_eigen": "extended Kalman filter in C++ with Eigen over a log",
        "default": "full step of the default estimator over a log",
        "default_live": "full step of the default estimator in place, called from Python",
    }  # fmt: skip
    found = [
        Row(f"kalman.{who}", what[who], "time per step [ns]", None, times[who].nanoseconds, None,
            settings)
        for who in contenders
    ]  # fmt: skip
    missing = "" if isinstance(reference, eigen.Reference) else reference
    pairs = [(one, other) for one in ("ekf", "default", "default_live") for other in ("ekf_eigen", "ekf_filterpy")]
    for one, other in (*pairs, ("ukf", "ekf_eigen"), ("ukf", "ukf_filterpy")):
        ratio = times[one].over(times[other]) if other in times else None
        found.append(
            Row(f"kalman.{one}_over_{other}", f"{what[one]} over {what[other]}", "ratio of times [-]", None, ratio,
                None, settings, 0, "" if other in times else missing)
        )  # fmt: skip
    return found
