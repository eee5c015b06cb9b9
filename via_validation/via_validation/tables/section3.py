"""Section 3, stiffness by modulating functions: Tables 1 and 2, the printed forms beside the right ones, Figures 3, 5.

The joint is the document's (Section 3.4, `cubic_aa_vsa`). Its excitation is not printed; E1 and E2 below stand for it,
smoothly ramped up from rest. Errors are those of the device stiffness for t in 2..10 s, as in Table 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import factorial, sqrt
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numba import njit
from via_bringup.demo.pictures import FAINT, MODEL, REAL, STYLE
from via_core.devices import Device, load_device
from via_core.metrics import mse, msrep
from via_core.signals import Array, Signals
from via_core.springs import SinhSpring
from via_core.status import Status
from via_core.weak_form import modulating
from via_estimators import modulating_errors as errors
from via_estimators import rls
from via_estimators.contract import Estimates, Estimator, rows_of
from via_estimators.modulated_stiffness import ModulatedStiffness, ModulatedStiffnessParameters
from via_estimators.modulated_torque import ModulatedTorque, ModulatedTorqueParameters
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

from via_validation.tables.rows import Progress, Row

TORQUE_RATIO = 2.82  # variance of signal over noise: what 'SNR = 9' means with the printed 20 log10
POSITION_RATIO = 1e7  # 'SNR = 140', likewise
FROM = 2.0  # [s] errors count from here on
TAU, THETA = (3, 5), (2, 4)  # columns of a log: t, q, theta_1, tau_1, theta_2, tau_2
EXCITATIONS = {"E1": (20.0, 0.5, 0.8), "E2": (40.0, 1.0, 1.7)}  # amplitude [N m], tones of motor 1 and 2 [Hz]
INERTIA, DAMPING = 1e-4, 1.27  # of the motors [kg m^2], [N m s/rad]
MSE, MSREP, RATIO = "MSE [(N m/rad)^2]", "MSREP [%]", "ratio [-]"
JOINT = "cubic_aa_vsa (eq. 35), 1 kHz, 10 s, errors for t in 2..10 s"

# What the document says of N: noise-free, noise on torques, noise on torques and positions; MSE and MSREP.
TABLE_2 = {
    (2, "clean"): (3.4e-2, 5e-5),
    (2, "torque_noise"): (19.3, 4.8e-2),
    (2, "all_noise"): (38.4, 1e-1),
    (4, "torque_noise"): (39.9, 8.7e-2),
    (4, "all_noise"): (56.7, 1.2e-1),
}
NO_POSITIONS = (
    "The size of this noise cannot be read off the document: its SNR formula takes logarithms of variance ratios as if "
    "they were amplitudes, and the signal whose variance counts is not named. At the ratio of 1e7 that the formula "
    "gives, noise on positions adds what this row shows, not the factor of two that is printed"
)


@dataclass(frozen=True)
class Log:
    """A joint's signals without noise, and the truth."""

    rows: Array  # (n, 6) t [s], q, theta_1 [rad], tau_1 [N m], theta_2, tau_2
    stiffness: Array  # (n,) of the device [N m/rad]

    @property
    def later(self) -> np.ndarray:
        """(n,) bool: where errors count."""
        return self.rows[:, 0] >= FROM - 1e-9

    def noisy(self, seed: int, torque: float, position: float = 0.0) -> Array:
        """Rows (n, 6) with white noise of these standard deviations [N m], [rad] on motor torques and motor angles."""
        rng, rows = np.random.default_rng(seed), self.rows.copy()
        rows[:, TAU] += torque * rng.normal(size=(len(rows), 2))
        if position > 0.0:
            rows[:, THETA] += position * rng.normal(size=(len(rows), 2))
        return rows

    def deviation(self, columns: tuple[int, int], ratio: float) -> float:
        """Standard deviation of noise at that ratio of variances, the signal's being the mean of the two columns'."""
        return sqrt(float(self.rows[self.later][:, columns].var(axis=0).mean()) / ratio)

    def every(self, stride: int) -> Log:
        """The log at a lower rate; a torque is the mean over the interval that ends at its stamp."""
        rows = self.rows[::stride].copy()
        for column in TAU:
            rows[1:, column] = self.rows[1:, column].reshape(-1, stride).mean(axis=1)
        return Log(rows, self.stiffness[::stride])


@cache
def cubic_log(excitation: str) -> Log:
    """The document's joint under E1 or E2, torques held over each millisecond."""
    amplitude, first, second = EXCITATIONS[excitation]
    t = np.arange(10_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    u = np.clip(middle / 0.3, 0.0, 1.0)
    ramp = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    tones = np.sin(2.0 * np.pi * middle[:, None] * np.array([first, second]))
    motor = ramp[:, None] * (60.0 + amplitude * tones) * np.array([1.0, -1.0])
    return _log(load_device("cubic_aa_vsa"), t, motor)


def _log(device: Device, t: Array, motor: Array) -> Log:
    commands = Signals(t, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))
    run = simulate(JointPlant.from_device(device), commands, len(t) / 1000.0, 1000.0)
    return Log(rows_of(run.measured, ("q", "theta_1", "tau_1", "theta_2", "tau_2")), np.array(run.truth["stiffness"]))


def differentiated(order: int, log: Log, stride: int = 1, span: float = 0.5) -> ModulatedStiffness:
    """Section 3's estimator with the document's settings (3.4), the noise declared as it is."""
    return ModulatedStiffness(
        ModulatedStiffnessParameters(
            taylor_order=order,
            window=round(span * 1000.0 / stride),
            sampling=1e-3 * stride,
            torque_noise=log.deviation(TAU, TORQUE_RATIO),
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
    """The default estimator, T = .2 s; a stiffness polynomial of order N has N / 2 + 1 odd terms of torque."""
    return ModulatedTorque(
        ModulatedTorqueParameters(
            order=order // 2 + 1,
            even_terms=order // 2 + 1 if even else 0,
            stiffness_deviation=1e5 if even else 300.0,  # too wide a prior to keep even terms small
            truncation=0.0,
            memory=1e9,
            deflection_scale=2.0,
            torque_noise=log.deviation(TAU, TORQUE_RATIO),
            position_noise=0.0,
        )
    )


@dataclass(frozen=True)
class Outcome:
    """Averages over noise realisations."""

    mse: float
    msrep: float
    ratio: float  # reported over empirical standard deviation [-]


@cache
def with_torque_noise(method: str, order: int, case: str, seeds: int) -> Outcome:
    """'differentiated' or 'undifferentiated' under the noise on torques of Table 2."""
    log = cubic_log(case)
    estimator = differentiated(order, log) if method == "differentiated" else undifferentiated(order, log)
    return outcome(estimator, log, seeds, log.deviation(TAU, TORQUE_RATIO))


def outcome(estimator: Estimator, log: Log, seeds: int, torque: float, position: float = 0.0) -> Outcome:
    """Errors and honesty over `seeds` realisations of the noise."""
    later, found, squares, variances = log.later, [], 0.0, 0.0
    for seed in range(seeds):
        value, deviation = estimator.run_rows(log.noisy(seed, torque, position))[1].column("stiffness")
        found.append((mse(log.stiffness[later], value[later]), msrep(log.stiffness[later], value[later])))
        squares += float(np.mean((value - log.stiffness)[later] ** 2))
        variances += float(np.mean(deviation[later] ** 2))
    average = np.mean(found, axis=0)
    return Outcome(float(average[0]), float(average[1]), sqrt(variances / squares))


@njit(cache=True, error_model="numpy")
def _recursion(gamma: Array, y: Array, prior: float, found: Array) -> None:
    """Coefficients found (n, k) after each of the rows gamma (n, k), from zero and P(0) = prior."""
    k = gamma.shape[1]
    P, w, gain = np.empty((k, k)), np.empty(k), np.empty(k)
    rls.start(P, w, prior)
    for row in range(y.size):
        rls.update(P, w, gamma[row], y[row], 1.0, gain)
        found[row] = w


def as_printed(log: Log, backwards: bool, filled: bool, order: int = 2, size: int = 500) -> Array:
    """Device stiffness (n,) by plain trapezoids and RLS on P, in the forms that are printed or in the right ones.

    backwards  sample k - m with the weight at m/H, as (26), (27) print it; else sample k - H + m
    filled     samples before the first are zero, as below (27); else nothing is estimated before a full window
    """
    span, u = size * 1e-3, np.arange(size + 1) / size
    W = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size
    weights = [W * span ** (3 - i) * modulating(3, i, u) for i in (1, 2, 3)]
    kernels = weights if backwards else [w[::-1] for w in weights]  # np.convolve pairs kernel[m] with sample k - m
    padding = size if filled else 0
    total = np.zeros(len(log.rows))
    for theta, tau in zip(THETA, TAU, strict=True):
        q, angle, held = (np.concatenate([np.zeros(padding), log.rows[:, c]]) for c in (1, theta, tau))
        torque = 0.5 * (held + np.append(held[1:], held[-1]))  # at the stamp, for a sampled curve
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
    """sigma^2 P with residuals taken for independent, over the scatter that it should be: least squares of all rows."""
    size, later = 500, log.later
    kernel = 0.25 / size * modulating(3, 1, np.arange(size + 1) / size)[::-1]
    bend, third = (0.5 ** (3 - i) / size * modulating(3, i, np.arange(size + 1) / size)[::-1] for i in (2, 3))
    third[[0, -1]] *= 0.5
    phi = log.rows[:, 1] - log.rows[:, 2]
    powers = np.stack([phi**j / factorial(j) for j in range(order + 1)], axis=1)
    gamma = np.stack([np.convolve(powers[:, j] * phi / (j + 1), kernel, "valid") for j in range(order + 1)], axis=1)
    P = np.linalg.inv(gamma.T @ gamma)
    pull = powers[later] @ P @ gamma.T
    spread = np.sqrt(np.einsum("ij,jk,ik->i", powers[later], P, powers[later]))
    clean = INERTIA * np.convolve(log.rows[:, 2], third, "valid") - DAMPING * np.convolve(log.rows[:, 2], bend, "valid")
    found, reported = [], []
    for seed in range(seeds):
        y = clean - np.convolve(log.noisy(seed, torque)[:, 3], kernel, "valid")
        alpha = P @ (gamma.T @ y)
        found.append(pull @ y)
        reported.append(sqrt(float(np.mean((y - gamma @ alpha) ** 2))) * spread)
    return float(np.sqrt(np.mean(np.square(reported)) / np.mean(np.var(found, axis=0))))


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Tables 1 and 2, what is printed beside what is right, and what VIA's own estimator makes of the same data."""
    parts: list[tuple[str, Callable[[int], list[Row]]]] = [
        ("Table 2, no noise", _clean),
        ("Table 2, noise on torques", _torque_noise),
        ("Table 2, noise on torques and positions", _position_noise),
        ("Table 1", _table_1),
        ("the forms as printed", _printed),
        ("the undifferentiated equation", _undifferentiated),
        ("w_33 against w_55", _orders),
        ("standard deviations", _deviations),
    ]
    table: list[Row] = []
    for done, (what, part) in enumerate(parts):
        progress(done, len(parts), what)
        table += part(seeds)
    progress(len(parts), len(parts), "done")
    return table


def _settings(case: str, order: int, noise: str) -> str:
    amplitude, first, second = EXCITATIONS[case]
    return (
        f"{JOINT}; {case}: 60 + {amplitude:g} sin at {first:g} and {second:g} Hz; N = {order}, T = .5 s, w_33, "
        f"P(0) = 1e8; {noise}"
    )


def _pair(identity: str, what: str, case: str, order: int, found: Outcome, limits: Sequence[float | None],
          noise: str, seeds: int, remark: str = "") -> list[Row]:  # fmt: skip
    """The MSE and the MSREP of a line of Table 2."""
    document = TABLE_2[(order, identity)]
    return [
        Row(f"3.table2.n{order}.{identity}.{case.lower()}.{short}", f"N = {order}, {what}, {case}", quantity, printed,
            value, limit, _settings(case, order, noise), seeds, remark)
        for short, quantity, printed, value, limit in zip(
            ("mse", "msrep"), (MSE, MSREP), document, (found.mse, found.msrep), limits, strict=True
        )
    ]  # fmt: skip


def _clean(_: int) -> list[Row]:
    table = []
    for case, limit in (("E2", 1e-3), ("E1", None)):
        log = cubic_log(case)
        found = outcome(differentiated(2, log), log, 1, 0.0)
        table += _pair("clean", "no noise, full window", case, 2, found, (limit, None), "no noise", 0)
    return table


def _torque_noise(seeds: int) -> list[Row]:
    table = []
    for order, case, limits in (
        (2, "E1", (25.0, 0.065)),
        (2, "E2", (25.0, 0.065)),
        (4, "E1", (32.0, None)),
        (4, "E2", (50.0, None)),
    ):
        found = with_torque_noise("differentiated", order, case, seeds)
        noise = f"variance of torques {TORQUE_RATIO} times that of their noise"
        remark = "'SNR 9' by the printed 20 log10 of a ratio of variances; 10 log10 would mean 7.9"
        table += _pair("torque_noise", "noise on torques", case, order, found, limits, noise, seeds, remark)
    return table


def _position_noise(seeds: int) -> list[Row]:
    table = []
    for order in (2, 4):
        for case in EXCITATIONS:
            log = cubic_log(case)
            torque, position = log.deviation(TAU, TORQUE_RATIO), log.deviation(THETA, POSITION_RATIO)
            found = outcome(differentiated(order, log), log, seeds, torque, position)
            noise = f"torques as above, {1e3 * position:.2g} mrad on motor angles (ratio {POSITION_RATIO:g})"
            table += _pair("all_noise", "noise on torques and positions", case, order, found, (None, None), noise,
                           seeds, NO_POSITIONS)  # fmt: skip
    return table


def _table_1(seeds: int) -> list[Row]:
    log = cubic_log("E2")
    torque = log.deviation(TAU, TORQUE_RATIO)
    table: list[Row] = []
    found: dict[int, float] = {}
    for milliseconds in (1, 2, 5, 10):
        slow = log.every(milliseconds)
        found[milliseconds] = outcome(differentiated(2, log, milliseconds), slow, seeds, torque).mse
        table.append(
            Row(f"3.table1.ts.{milliseconds}ms.mse", f"Ts = {milliseconds} ms, noise on torques", MSE, None,
                found[milliseconds], None, _settings("E2", 2, "the same noise per sample"), seeds)
        )  # fmt: skip
    slower, wider = noise(0.5, 100) / noise(0.5, 500), noise(0.5, 500) / noise(0.25, 250)
    setting = "white noise on torques, w_33; standard deviation of e_w over T^3/c_3, the scale of its row"
    table += [
        Row("3.table1.ts.direction", "Ts up, noise UP (printed: down): MSE at 1 ms over 10 ms", RATIO, None,
            found[1] / found[10], 0.5, _settings("E2", 2, "the same noise per sample"), seeds,
            "The arrow of Table 1 points the wrong way: a window of fewer samples averages less"),
        Row("3.table1.ts.noise", "Ts up, noise UP (printed: down): 1 ms over 5 ms", RATIO, None, 1.0 / slower, 1.0,
            setting),
        Row("3.table1.t.noise", "T up, noise down: T = .5 s over .25 s", RATIO, None, wider, 1.0, setting),
        Row("3.table1.t.mse", "T up: MSE at T = .5 s over T = .25 s", RATIO, None,
            found[1] / outcome(differentiated(2, log, span=0.25), log, seeds, torque).mse, None,
            _settings("E2", 2, "noise on torques"), seeds,
            "A longer window takes noise out of one row, not out of the least squares over all of them"),
    ]  # fmt: skip
    setting = "tau_e = sinh(1.5 phi), phi = 1.8 sin(2 pi t), w_33; largest |e_RN| over T^3/c_3, the scale of its row"
    table += [
        Row("3.table1.n.truncation", "N up, truncation down: N = 4 over N = 2, T = .5 s", RATIO, None,
            truncation(4, 0.5) / truncation(2, 0.5), 1.0, setting),
        Row("3.table1.ts.truncation", "Ts up, truncation unchanged: 10 ms over 1 ms", RATIO, None,
            truncation(2, 0.5, 10) / truncation(2, 0.5), 1.01, setting),
        Row("3.table1.t.truncation", "T up, truncation (printed: up): T = .5 s over .25 s", RATIO, None,
            truncation(2, 0.5) / truncation(2, 0.25), None, setting, 0,
            "Up only in the scale of (26), (27), where all of a row grows like T^3; beside what the row says it falls"),
    ]  # fmt: skip
    return table


def noise(span: float, intervals: int) -> float:
    """Standard deviation of a row for 1 N m of noise, as a rate of torque [N m/s]."""
    return errors.noise_deviation(1.0, intervals, span)


def truncation(order: int, span: float, period: int = 1) -> float:
    """Largest error of a row as a rate of torque [N m/s], where a sinh law meets its Taylor polynomial of order N."""
    law, alpha = SinhSpring(3.0, 1.0, 1.5), [1.5, 0.0, 3.375, 0.0, 7.59375]
    phi = 1.8 * np.sin(2.0 * np.pi * 1e-3 * np.arange(0, 4000, period))
    rho = errors.remainder(law, alpha[: order + 1], phi)
    found = errors.truncation_errors(rho, round(span * 1000.0 / period), span)
    return float(np.abs(found).max()) / errors.row_scale(span)


def _printed(_: int) -> list[Row]:
    table = []
    for case in EXCITATIONS:
        log = cubic_log(case)
        late = Log(log.rows[500:], log.stiffness[500:])
        for identity, what, of, backwards, filled in (
            ("right", "plain trapezoids, sample k - H + m, from rest", log, False, True),
            ("sampling", "printed form: sample k - m at m/H, from rest", log, True, True),
            ("waiting", "log that begins in motion (.5 s later), full window", late, False, False),
            ("zero_filled", "printed form: zeros before a log that begins in motion (.5 s later)", late, False, True),
        ):
            found = mse(of.stiffness[of.later], as_printed(of, backwards, filled)[of.later])
            table.append(
                Row(f"3.printed.{identity}.{case.lower()}.mse", f"{what}, {case}", MSE, None, found, None,
                    _settings(case, 2, "no noise"))
            )  # fmt: skip
    return table


def _undifferentiated(seeds: int) -> list[Row]:
    table = []
    for order, limit in ((2, 8.0), (4, 20.0)):
        for case in EXCITATIONS:
            log = cubic_log(case)
            torque = log.deviation(TAU, TORQUE_RATIO)
            settings = (
                f"{JOINT}; {case}; modulated_torque, T = .2 s, w_55, B and D unknown; noise on torques as in Table 2"
            )
            found = with_torque_noise("undifferentiated", order, case, seeds).mse
            table.append(
                Row(f"3.undifferentiated.n{order}.{case.lower()}.mse", f"same data, odd basis for N = {order}, {case}",
                    MSE, None, found, limit, settings, seeds)
            )  # fmt: skip
            every = outcome(undifferentiated(order, log, even=True), log, seeds, torque).mse
            table.append(
                Row(f"3.basis.n{order}.{case.lower()}.gain", f"all powers instead of odd ones, N = {order}, {case}",
                    "MSE, ratio [-]", None, every / found, None, settings, seeds,
                    "The prior of all powers is too wide to help; deflections keep their sign under E1 and E2")
            )  # fmt: skip
    return table


def _orders(_: int) -> list[Row]:
    """Inertia found on the document's VSA-II, 7.5e-3 kg m^2, without noise."""
    t = np.arange(20_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    torque = 0.05 * np.stack([np.sin(0.1 * np.pi * middle), np.sin(2.0 * np.pi * middle)], axis=1)
    nominal = load_device("vsa2")
    changes = {"inertia": 7.5e-3, "viscous_friction": 0.9e-3}
    device = nominal.model_copy(update={"motors": tuple(each.model_copy(update=changes) for each in nominal.motors)})
    log = _log(device, t, torque)
    base = ModulatedTorque.from_device(nominal).parameters
    settings = (
        "vsa2 with B 7.5, D .9, tau = 50 sin(.1 pi t), 50 sin(2 pi t) N mm, 20 s, no noise; T = .2 s, 5 odd terms"
    )
    table = []
    for order in (3, 5):
        estimator = ModulatedTorque(
            replace(base, modulating_order=order, memory=1e9, order=5, torque_noise=1e-5, position_noise=0.0)
        )
        found = estimator.run_rows(log.rows)[1].column("motor_inertia_1")[0][-1]
        for identity, what, inertia in (
            ("trapezoid", "plain trapezoids, batch least squares", trapezoid_inertia(log, order)),
            ("ours", "weights exact for polynomials, modulated_torque", float(found)),
        ):
            table.append(
                Row(f"3.order.w{order}{order}.{identity}.inertia", f"w_{order}{order}, {what}; truth 7.5",
                    "B of motor 1 [kg m mm]", None, 1e3 * inertia, None, settings)
            )  # fmt: skip
    return table


def trapezoid_inertia(log: Log, order: int, size: int = 200, terms: int = 5) -> float:
    """Inertia [kg m^2] of motor 1 by batch least squares on undifferentiated rows, weights as in (24), corrected."""
    u = np.arange(size + 1) / size
    W = np.where((u == 0.0) | (u == 1.0), 0.5, 1.0) / size
    kernels = [(W * modulating(order, i, u) * (1e-3 * size) ** (2 - i))[::-1] for i in range(3)]
    q, theta, held = log.rows[:, 1:4].T
    torque = 0.5 * (held + np.append(held[1:], held[-1]))  # at the stamp, for a sampled curve
    columns = [np.convolve(theta, kernels[2], "valid"), -np.convolve(theta, kernels[1], "valid")]
    columns += [-np.convolve((q - theta) ** (2 * p + 1), kernels[0], "valid") for p in range(terms)]
    regressors = np.stack(columns, axis=1)
    scale = np.abs(regressors).max(axis=0)
    found = np.linalg.lstsq(regressors / scale, np.convolve(torque, kernels[0], "valid"), rcond=None)[0]
    return float(found[0] / scale[0])


def _deviations(seeds: int) -> list[Row]:
    table = []
    for case in EXCITATIONS:
        log = cubic_log(case)
        torque = log.deviation(TAU, TORQUE_RATIO)
        for name in ("differentiated", "undifferentiated"):
            for order in (2, 4):
                ratio = with_torque_noise(name, order, case, seeds).ratio
                table.append(
                    Row(f"3.deviation.{name}.n{order}.{case.lower()}", f"reported sd, {name}, N = {order}, {case}",
                        "sd reported over empirical, or its inverse [-]", None, max(ratio, 1.0 / ratio), 1.25,
                        f"{JOINT}; {case}; noise on torques as in Table 2", seeds, f"reported / empirical {ratio:.2f}")
                )  # fmt: skip
        naive = naive_ratio(log, seeds, torque)
        table.append(
            Row(f"3.deviation.naive.{case.lower()}", f"sigma^2 P, which takes rows for independent, {case}",
                "sd empirical over reported [-]", None, 1.0 / naive, None, f"{JOINT}; {case}; N = 2", seeds,
                "Windows overlap: neighbouring rows hold almost the same noise")
        )  # fmt: skip
    return table


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figure 3 (a, b, c) and Figure 5 (a, b)."""
    progress(0, 2, "Figure 3")
    paths = [_figure_3(folder / "figure_3.png")]
    progress(1, 2, "Figure 5")
    paths.append(_figure_5(folder / "figure_5.png"))
    progress(2, 2, "done")
    return paths


def _figure_3(path: Path) -> Path:
    log = cubic_log("E1")
    torque, position = log.deviation(TAU, TORQUE_RATIO), log.deviation(THETA, POSITION_RATIO)
    cases = (
        ("(a) noisy torques, clean positions, N = 2", 2, 0.0),
        ("(b) noisy torques and positions, N = 2", 2, position),
        ("(c) noisy torques and positions, N = 4", 4, position),
    )
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(3, 1, figsize=(9, 9.6), sharex=True, sharey=True, constrained_layout=True)
        for axes, (title, order, blur) in zip(panels, cases, strict=True):
            estimates = differentiated(order, log).run_rows(log.noisy(0, torque, blur))[1]
            axes.plot(log.rows[:, 0], _known(estimates), color=MODEL, label="estimate")
            axes.plot(log.rows[:, 0], log.stiffness, color=REAL, linestyle="--", label="truth")
            axes.set_title(title, fontsize=12)
            axes.set_ylabel("stiffness [N m/rad]")
        panels[0].legend(loc="upper right", ncols=2)
        panels[-1].set_xlabel("time [s]")
        panels[0].set_ylim(0.0, 1.4 * log.stiffness.max())
        _save(figure, path)
    return path


def exponential_log() -> tuple[Device, Log]:
    """An antagonistic joint with exponential springs that deflects by a radian, in slow motion for 20 s."""
    t = np.arange(20_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    tones = np.stack([np.sin(2.0 * np.pi * 0.31 * middle), np.sin(2.0 * np.pi * 0.47 * middle + 1.0)], axis=1)
    motor = np.clip(t / 0.5, 0.0, 1.0)[:, None] * (2.5 + 1.5 * tones) * np.array([1.0, -1.0])
    device = load_device("dlr_bavs")
    smooth = tuple(each.model_copy(update={"coulomb_friction": 0.0}) for each in device.motors)
    rise, fall = (
        {"k": 1.0, "rise": a, "fall": b, "a": 3.0, "max_deflection": 1.5} for a, b in ((0.05, 0.25), (0.25, 0.05))
    )
    springs = tuple(each.model_copy(update=law) for each, law in zip(device.springs, (rise, fall), strict=True))
    device = device.model_copy(update={"motors": smooth, "springs": springs})
    return device, _log(device, t, motor)


def _figure_5(path: Path) -> Path:
    """N = 9, T = .5 s, P(0) = 1e5 on exponential springs; the document's own device and data are not available."""
    device, log = exponential_log()
    parameters = ModulatedStiffness.from_device(device).parameters
    estimator = ModulatedStiffness(replace(parameters, taylor_order=9, initial_covariance=1e5, torque_noise=0.02))
    estimates = estimator.run_rows(log.noisy(0, 0.02))[1]
    value = _known(estimates)
    with plt.rc_context(STYLE):
        figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 7), sharex=True, constrained_layout=True)
        top.plot(log.rows[:, 0], value, color=MODEL, label="estimate")
        top.plot(log.rows[:, 0], log.stiffness, color=REAL, linestyle="--", label="truth (simulated)")
        top.set_ylim(0.0, 1.3 * log.stiffness.max())
        top.set_ylabel("total device stiffness [N m/rad]")
        top.legend(loc="upper right", ncols=2)
        top.set_title("exponential springs in simulation, N = 9; the document's device is not available", fontsize=12)
        bottom.plot(log.rows[:, 0], 100.0 * np.abs(value / log.stiffness - 1.0), color=MODEL)
        bottom.axhline(25.0, color=FAINT, linestyle="--")
        bottom.set_ylim(0.0, 60.0)
        bottom.set_ylabel("relative error [%]")
        bottom.set_xlabel("time [s]")
        _save(figure, path)
    return path


def _known(estimates: Estimates) -> Array:
    """Device stiffness (n,), NaN while nothing is known of it."""
    return np.where(estimates.status == Status.WARMING_UP, np.nan, estimates.column("stiffness")[0])


def _save(figure: plt.Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
