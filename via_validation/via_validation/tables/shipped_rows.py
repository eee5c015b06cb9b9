"""Rows of Sections 3 and 4 at shipped settings: intervals of every method, errors of the noisy VSA-II."""

from __future__ import annotations

from functools import partial
from math import sqrt

import numpy as np
from via_core.devices import load_device
from via_core.signals import Array, Signals
from via_estimators.methods import method_for

from via_validation.tables.cubic_joint import EXCITATIONS, POSITION_RATIO, TAU, THETA, TORQUE_RATIO, Log, cubic_log
from via_validation.tables.rows import Row
from via_validation.tables.shipped import Errors, Plant, errors, measured_methods, outside_row, with_sensors
from via_validation.tables.vsa2 import DAMPING, FAST, INERTIA, SLOW, VARIANTS, Motion, motion

MM = 1e3  # N mm per N m
UNITS = {"q": "rad", "theta": "rad", "tau": "N m", "theta_velocity": "rad/s"}
# (t > 5 s, t > 2 s) [(N mm/rad)^2], B [%] and D [%]: limits of 4.4 for the method of 4.4 and for the default.
LIMITS = {"v1": (6.0, 100.0), "v2": (0.5, 20.0), "v3": (0.3, 80.0)}
PRINTED_METHOD = "filtered_signal_based"  # the method of 4.4
MOTOR = {"B": (INERTIA, 0.1), "D": (DAMPING, 2.0)}
CONSTANT = "the spring law counts as constant: the estimate is a mean over its memory, and the interval has no drift"
REASONS = {
    "modulated_stiffness": "the motor of the device file counts as exact, but is 3 and 10 % off",
    "filtered_signal_based": CONSTANT,
    "signal_based": CONSTANT,
}
NOISY_REASON = "truncation error of the basis: the last term underestimates the first one left out"
MORE_UNKNOWNS = (
    "the default also estimates dry friction and the torque's delay, and expects that springs may change; the limit is "
    "that of constant springs, with a basis chosen for this plant"
)
UNSEEN = (
    "at shipped settings the prior of the stiffness has the order of magnitude of the device file only. From 2 to 5 s "
    "the joint reaches deflections for the first time, and there the estimate is the prior's"
)


def cubic_rows(seeds: int) -> list[Row]:
    """Intervals of every method on the joint of Section 3, with the noise of Table 2."""
    found = []
    for case in EXCITATIONS:
        log = cubic_log(case)
        torque, position = log.noise_sd(TAU, TORQUE_RATIO), log.noise_sd(THETA, POSITION_RATIO)
        for key, words, noise, error in (
            ("clean", "no noise", 0.0, 0.0),
            ("torque_noise", "noise on torques", torque, 0.0),
            ("all_noise", "noise on torques and positions", torque, position),
        ):
            device = with_sensors(load_device("cubic_aa_vsa"), None, noise, error * sqrt(12.0) or None)

            plant = Plant(device, partial(_noisy_cubic, log, noise, error), log.stiffness, noise > 0.0)
            settings = f"cubic_aa_vsa (eq. 35), {case}, 1 kHz, 10 s, t >= 2 s; {words} as in Table 2; shipped settings"
            for method in measured_methods(plant):
                each = errors(plant, method, seeds)
                at, what = f"3.shipped.{key}.{case.lower()}.{method}", f"{method}, {words}, {case}"
                found.append(outside_row(at, what, each, settings, REASONS.get(method, "")))
    return found


def vsa2_rows(seeds: int) -> list[Row]:
    """Intervals of every method on the VSA-II of Section 4, ideal and noisy, and errors of the noisy one."""
    found = []
    for variant, name in VARIANTS.items():
        device = load_device(name)
        for drift, key, words in ((SLOW, "slow", ".0005 t"), (FAST, "fast", ".5 t")):
            truth = motion(variant, drift).stiffness
            plant = Plant(
                with_sensors(device, None, 0.0, None), partial(_with_velocity, motion(variant, drift)), truth, False
            )
            settings = f"VSA-II, {variant.upper()}, k 500 + {words}, ideal signals, t >= 2 s; shipped settings"
            for method in measured_methods(plant):
                at, what = f"4.shipped.table3.{variant}.{key}.{method}", f"{method}, {variant.upper()}, k 500 + {words}"
                found.append(outside_row(at, what, errors(plant, method, 1), settings, REASONS.get(method, "")))
        run = motion(variant)
        plant = Plant(device, partial(_noisy_vsa2, run), run.stiffness, True)
        settings = f"VSA-II, {variant.upper()}, 14 bit encoders, torque noise 1 N mm, 20 s; shipped settings"
        for method in measured_methods(plant):
            each, at = errors(plant, method, seeds), f"4.shipped.noisy.{variant}.{method}"
            what = f"{method}, noisy VSA-II, {variant.upper()}"
            reason = NOISY_REASON if method == PRINTED_METHOD else REASONS.get(method, "")
            found.append(outside_row(at, what, each, settings, reason))
            found += _error_rows(at, what, each, settings, variant, method in (PRINTED_METHOD, method_for(device)))
    return found


def _error_rows(at: str, what: str, each: Errors, settings: str, variant: str, limited: bool) -> list[Row]:
    """MSE and, for methods that estimate the motor, RMS over seeds of its parameters; limits if `limited`."""
    found, method = [], at.rpartition(".")[2]
    for key, value, limit in zip(("mse_5", "mse_2"), (each.mse_5, each.mse_2), LIMITS[variant], strict=True):
        squares, least = MM**2 * value, limit if limited else None
        remark = f"of the OK estimates from 2 s on: {MM**2 * each.mse_ok:.3g}"
        if limited and squares > limit:
            remark += f"; {UNSEEN if key == 'mse_2' else NOISY_REASON if method == PRINTED_METHOD else MORE_UNKNOWNS}"
        after, unit = f"{what}, device, t > {key[-1]} s", "MSE [(N mm/rad)^2]"
        found.append(Row(f"{at}.{key}", after, unit, None, squares, least, settings, each.seeds, remark))
    for symbol, (truth, limit) in MOTOR.items():
        values = each.inertia if symbol == "B" else each.damping
        if not np.all(np.isfinite(values)):
            continue
        rms = 100.0 * float(np.sqrt(np.mean((values / truth - 1.0) ** 2, axis=0)).max())
        found.append(
            Row(f"{at}.{symbol}.rms", f"{what}, {symbol}: RMS over seeds, worse motor", "error [%]", None, rms,
                limit if limited else None, settings, each.seeds,
                _motor_reason(method, variant, symbol) if limited and rms > limit else "")
        )  # fmt: skip
    return found


def _motor_reason(method: str, variant: str, symbol: str) -> str:
    bound = f"the Cramer-Rao bound of constant springs is in row 4.noisy.{variant}.{symbol}.bound"
    return bound if method == PRINTED_METHOD else f"{MORE_UNKNOWNS}; {bound}"


def _noisy_cubic(log: Log, torque: float, position: float, seed: int) -> Signals:
    return _without_velocity(log.noisy(seed, torque, position))


def _noisy_vsa2(run: Motion, seed: int) -> Signals:
    return _without_velocity(run.noisy(seed))


def _without_velocity(rows: Array) -> Signals:
    """Signals of rows (n, 6): t, q, theta_1, tau_1, theta_2, tau_2."""
    channels = {"q": rows[:, 1], "theta": rows[:, THETA], "tau": rows[:, TAU]}
    return Signals(rows[:, 0], channels, {name: UNITS[name] for name in channels})


def _with_velocity(run: Motion, _seed: int) -> Signals:
    """Exact signals of a run, with motor velocities."""
    return Signals(run.time, {name: getattr(run, name) for name in UNITS}, UNITS)
