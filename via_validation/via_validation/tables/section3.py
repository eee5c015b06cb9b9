"""Section 3, stiffness by modulating functions: Tables 1 and 2, and the printed forms compared with the correct ones.

The joint is the document's (`cubic_joint`). Errors are those of the device stiffness for t in 2..10 s, as in Table 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.devices import load_device
from via_estimators.modulated_torque import ModulatedTorque

from via_validation.tables.cubic_joint import (
    EXCITATIONS,
    POSITION_RATIO,
    TAU,
    THETA,
    TORQUE_RATIO,
    Log,
    cubic_log,
    log_of,
)
from via_validation.tables.errors import mse
from via_validation.tables.rows import Progress, Row
from via_validation.tables.section3_methods import (
    Outcome,
    as_printed,
    differentiated,
    naive_ratio,
    noise,
    outcome,
    trapezoid_inertia,
    truncation,
    undifferentiated,
    with_torque_noise,
)
from via_validation.tables.section3_pictures import pictures
from via_validation.tables.shipped_rows import cubic_rows

__all__ = ["pictures", "rows"]

MSE, MSREP, RATIO = "MSE [(N m/rad)^2]", "MSREP [%]", "ratio [-]"
JOINT = "cubic_aa_vsa (eq. 35), 1 kHz, 10 s, errors for t in 2..10 s"

# Table 2 by N and noise: none, on torques, on torques and positions. MSE and MSREP.
TABLE_2 = {
    (2, "clean"): (3.4e-2, 5e-5),
    (2, "torque_noise"): (19.3, 4.8e-2),
    (2, "all_noise"): (38.4, 1e-1),
    (4, "torque_noise"): (39.9, 8.7e-2),
    (4, "all_noise"): (56.7, 1.2e-1),
}
NO_POSITIONS = (
    "The document does not define this noise: its SNR formula treats variance ratios as amplitude ratios, and the "
    "signal whose variance counts is not named. At the ratio of 1e7 from the formula, noise on positions adds what "
    "this row shows, not the printed factor of two"
)


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Rows of Tables 1 and 2, of the printed and the correct forms, and of VIA's own estimator on the same data."""
    parts: list[tuple[str, Callable[[int], list[Row]]]] = [
        ("Table 2, no noise", _clean),
        ("Table 2, noise on torques", _torque_noise),
        ("Table 2, noise on torques and positions", _position_noise),
        ("Table 1", _table_1),
        ("the forms as printed", _printed),
        ("the undifferentiated equation", _undifferentiated),
        ("w_33 against w_55", _orders),
        ("standard deviations", _standard_deviations),
        ("shipped settings", cubic_rows),
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


@dataclass(frozen=True)
class _Line:
    """A kind of line of Table 2: key of TABLE_2, description, number of seeds, and remark."""

    key: str
    what: str
    seeds: int
    remark: str = ""

    def rows(self, case: str, order: int, found: Outcome, limits: Sequence[float | None], noise: str) -> list[Row]:
        """The MSE and the MSREP for an excitation and an order N; `noise` describes the noise."""
        document = TABLE_2[(order, self.key)]
        return [
            Row(f"3.table2.n{order}.{self.key}.{case.lower()}.{short}", f"N = {order}, {self.what}, {case}", quantity,
                printed, value, limit, _settings(case, order, noise), self.seeds, self.remark)
            for short, quantity, printed, value, limit in zip(
                ("mse", "msrep"), (MSE, MSREP), document, (found.mse, found.msrep), limits, strict=True
            )
        ]  # fmt: skip


def _clean(_: int) -> list[Row]:
    table, line = [], _Line("clean", "no noise, full window", 0)
    for case, limit in (("E2", 1e-3), ("E1", None)):
        log = cubic_log(case)
        found = outcome(differentiated(2, log), log, 1, 0.0)
        table += line.rows(case, 2, found, (limit, None), "no noise")
    return table


def _torque_noise(seeds: int) -> list[Row]:
    remark = "'SNR 9' by the printed 20 log10 of a ratio of variances; 10 log10 would mean 7.9"
    table, line = [], _Line("torque_noise", "noise on torques", seeds, remark)
    for order, case, limits in (
        (2, "E1", (25.0, 0.065)),
        (2, "E2", (25.0, 0.065)),
        (4, "E1", (32.0, None)),
        (4, "E2", (50.0, None)),
    ):
        found = with_torque_noise("differentiated", order, case, seeds)
        noise = f"variance of torques {TORQUE_RATIO} times that of their noise"
        table += line.rows(case, order, found, limits, noise)
    return table


def _position_noise(seeds: int) -> list[Row]:
    table, line = [], _Line("all_noise", "noise on torques and positions", seeds, NO_POSITIONS)
    for order in (2, 4):
        for case in EXCITATIONS:
            log = cubic_log(case)
            torque, position = log.noise_sd(TAU, TORQUE_RATIO), log.noise_sd(THETA, POSITION_RATIO)
            found = outcome(differentiated(order, log), log, seeds, torque, position)
            noise = f"torques as above, {1e3 * position:.2g} mrad on motor angles (ratio {POSITION_RATIO:g})"
            table += line.rows(case, order, found, (None, None), noise)
    return table


def _table_1(seeds: int) -> list[Row]:
    log = cubic_log("E2")
    torque = log.noise_sd(TAU, TORQUE_RATIO)
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
            "The arrow in Table 1 has the wrong direction: a window of fewer samples averages less"),
        Row("3.table1.ts.noise", "Ts up, noise UP (printed: down): 1 ms over 5 ms", RATIO, None, 1.0 / slower, 1.0,
            setting),
        Row("3.table1.t.noise", "T up, noise down: T = .5 s over .25 s", RATIO, None, wider, 1.0, setting),
        Row("3.table1.t.mse", "T up: MSE at T = .5 s over T = .25 s", RATIO, None,
            found[1] / outcome(differentiated(2, log, span=0.25), log, seeds, torque).mse, None,
            _settings("E2", 2, "noise on torques"), seeds,
            "A longer window reduces the noise of one row, but not of the least squares over all rows"),
    ]  # fmt: skip
    setting = "tau_e = sinh(1.5 phi), phi = 1.8 sin(2 pi t), w_33; largest |e_RN| over T^3/c_3, the scale of its row"
    table += [
        Row("3.table1.n.truncation", "N up, truncation down: N = 4 over N = 2, T = .5 s", RATIO, None,
            truncation(4, 0.5) / truncation(2, 0.5), 1.0, setting),
        Row("3.table1.ts.truncation", "Ts up, truncation unchanged: 10 ms over 1 ms", RATIO, None,
            truncation(2, 0.5, 10) / truncation(2, 0.5), 1.01, setting),
        Row("3.table1.t.truncation", "T up, truncation (printed: up): T = .5 s over .25 s", RATIO, None,
            truncation(2, 0.5) / truncation(2, 0.25), None, setting, 0,
            "Up only in the scale of (26), (27), where all terms of a row grow like T^3; relative to the row it falls"),
    ]  # fmt: skip
    return table


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
            torque = log.noise_sd(TAU, TORQUE_RATIO)
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
                    "The prior of all powers is too wide to help; deflections do not change sign under E1 and E2")
            )  # fmt: skip
    return table


def _orders(_: int) -> list[Row]:
    """Rows of the inertia estimated for the document's VSA-II without noise; the truth is 7.5e-3 kg m^2."""
    t = np.arange(20_000, dtype=np.float64) * 1e-3
    middle = t + 5e-4
    torque = 0.05 * np.stack([np.sin(0.1 * np.pi * middle), np.sin(2.0 * np.pi * middle)], axis=1)
    nominal = load_device("vsa2")
    changes = {"inertia": 7.5e-3, "viscous_friction": 0.9e-3}
    device = nominal.model_copy(update={"motors": tuple(each.model_copy(update=changes) for each in nominal.motors)})
    log = log_of(device, t, torque)
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


def _standard_deviations(seeds: int) -> list[Row]:
    table = []
    for case in EXCITATIONS:
        log = cubic_log(case)
        torque = log.noise_sd(TAU, TORQUE_RATIO)
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
            Row(f"3.deviation.naive.{case.lower()}", f"sigma^2 P, which assumes independent rows, {case}",
                "sd empirical over reported [-]", None, 1.0 / naive, None, f"{JOINT}; {case}; N = 2", seeds,
                "Windows overlap: neighbouring rows contain almost the same noise")
        )  # fmt: skip
    return table
