"""Cost of the estimators: kernels compared with other libraries, a full step of every method, memory, and growth.

A full step includes the window, least squares, standard deviations and status. It is timed three ways: one sample at a
time from Python by the pure `step`, which returns a new state; by `Live`, as in a node; and over a whole log by
`run_rows`.
"""

from __future__ import annotations

import gc
import os
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from via_core.devices import Device, device_names, load_device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_estimators.contract import Estimator, Live
from via_estimators.methods import METHODS, estimator_for, method_for, methods_for
from via_estimators.modulated_torque import ModulatedTorque
from via_estimators.torque_equation import U

from via_validation.bench.kalman import ONE_TRANSMISSION, kalman_rows
from via_validation.bench.kernels import kernel_rows
from via_validation.bench.timing import Contender, take_turns
from via_validation.tables.rows import Row

STEP_LIMIT = 10.0  # [us] of one full step of a default method, estimation.md
PREFERRED = (
    "qbmove_a",
    "vsa2",
    "cubic_aa_vsa",
    "maccepavd",
    "compact_vpda",
)  # the first one that suits a method is used
SAMPLES, FOLDED = 500, 5000
LONG = 1_000_000  # samples of the memory test
Progress = Callable[[str], None]


def estimator_rows(turns: int, progress: Progress) -> list[Row]:
    """All rows of `via bench estimators`, from `turns` alternating repeats."""
    found: list[Row] = []
    for what, work in (
        ("kernels", lambda: kernel_rows(turns)),
        ("Kalman filters", lambda: kalman_rows(turns)),
        ("steps", lambda: step_rows(turns)),
        ("growth", lambda: growth_rows(turns)),
        ("memory", memory_rows),
    ):
        progress(what)
        found += work()
    return found


def device_for(method: str) -> Device:
    """A device suited to the method: a preferred one if possible, else the first by name."""
    for name in (*PREFERRED, *device_names()):
        device = load_device(name)
        if method in methods_for(device):
            return device
    raise ParameterError(f"no shipped device suits the method '{method}'; methods are: {', '.join(METHODS)}")


def moving_rows(estimator: Estimator, count: int, start: int = 0) -> Array:
    """Rows (count, 1 + k) at 1 kHz from sample `start` on, with a different sine in every column."""
    t = np.arange(start, start + count) * 1e-3
    columns = [0.4 * np.sin((5.0 + at) * t + at) for at, _ in enumerate(estimator.inputs)]
    return np.column_stack([t, *columns])


def step_rows(turns: int) -> list[Row]:
    """Rows of one full step of every method on a suitable device, beside the default of that device.

    A step of an antagonistic joint has two regressions; these methods are also timed on a joint with one.
    """
    cases = {method: device_for(method) for method in METHODS}
    single = load_device(ONE_TRANSMISSION)
    cases |= {f"one.{method}": single for method, device in cases.items() if device.n_transmissions == 2}
    contenders: dict[str, Contender] = {}
    settings = {}
    for case, device in cases.items():
        estimator = estimator_for(device, case.removeprefix("one."))
        contenders |= _contenders(case, estimator)
        settings[case] = (
            f"{device.name}, transmissions: {device.n_transmissions}, {estimator.init().nbytes} bytes of state, median "
            f"of {turns} alternating turns, one thread"
        )
    times = take_turns(contenders, turns)
    rows = []
    for case, device in cases.items():
        one, method = case.startswith("one."), case.removeprefix("one.")
        default = method_for(device)
        for how, what in (
            ("call", "pure, called from Python"),
            ("live", "in place, called from Python"),
            ("fold", "over a whole log"),
        ):
            taken, known = times[f"{case} {how}"].nanoseconds, f"{'one.' * one}{default} {how}"
            beside = known in times and method != default
            rows.append(
                Row(f"step.{case}.{how}", f"{method}{', one transmission' * one}: one full step, {what}", "time [us]",
                    None, 1e-3 * taken, STEP_LIMIT if method == default else None, settings[case], 0,
                    f"{taken / times[known].nanoseconds:.2g} times {default}" if beside else "")
            )  # fmt: skip
    return rows


def _contenders(name: str, estimator: Estimator) -> dict[str, Contender]:
    """The three ways to run steps, each from the state after 2 s of motion."""
    state, _ = estimator.run_rows(moving_rows(estimator, 2000))
    rows = moving_rows(estimator, FOLDED, 2000)

    def call() -> None:
        at = state
        for row in rows[:SAMPLES]:
            at, _ = estimator.step(at, row)

    fed = Live(estimator)
    for row in moving_rows(estimator, 2000):
        fed.take(row.reshape(1, -1))
    block = rows[:SAMPLES, None, :].copy()

    def live() -> None:
        for row in block:
            fed.take(row)
        block[:, 0, 0] += SAMPLES * 1e-3  # stamps must increase

    return {
        f"{name} call": Contender(SAMPLES, call),
        f"{name} live": Contender(SAMPLES, live),
        f"{name} fold": Contender(FOLDED, lambda: estimator.run_rows(rows, state)),
    }


def growth_rows(turns: int) -> list[Row]:
    """Rows of time and state size of the default method for more parameters, longer windows and more joints."""
    base = ModulatedTorque.from_device(load_device("qbmove_a"))
    cases: dict[str, tuple[str, Estimator]] = {}
    for order in (1, 2, 3, 4, 5, 6):
        cases[f"parameters.{U.size + order}"] = (
            f"{U.size + order} unknowns per transmission",
            base.with_parameters(replace(base.parameters, order=order, even_terms=0)),
        )
    for intervals in (50, 100, 200, 400, 800):
        cases[f"window.{intervals}"] = (
            f"window of {intervals} intervals",
            base.with_parameters(replace(base.parameters, window=intervals)),
        )
    contenders = {name: _contenders(name, estimator)[f"{name} fold"] for name, (_, estimator) in cases.items()}
    joints = {f"joints.{count}": count for count in (1, 2, 4, 8, 16)}
    contenders |= {name: _joints(base, count) for name, count in joints.items()}
    times = take_turns(contenders, turns)
    settings = f"modulated_torque on qbmove_a, two transmissions, median of {turns} alternating turns, one thread"
    rows = []
    for name, (what, estimator) in cases.items():
        microseconds, size = 1e-3 * times[name].nanoseconds, estimator.init().nbytes / 1024.0
        rows.append(
            Row(f"growth.{name}.time", what, "time of a step over a log [us]", None, microseconds, None, settings)
        )
        rows.append(Row(f"growth.{name}.state", what, "state [KiB]", None, size, None, settings))
    for name, count in joints.items():
        what = f"{count} joints, one step each, called from Python"
        rows.append(Row(f"growth.{name}.time", what, "time of a tick [us]", None, 1e-3 * times[name].nanoseconds, None,
                        settings))  # fmt: skip
    return rows


def _joints(estimator: Estimator, count: int) -> Contender:
    """Ticks of `count` joints with separate states."""
    start, _ = estimator.run_rows(moving_rows(estimator, 2000))
    rows = moving_rows(estimator, SAMPLES, 2000)

    def run() -> None:
        states = count * [start]
        for row in rows:
            states = [estimator.step(state, row)[0] for state in states]

    return Contender(SAMPLES, run)


def memory_rows() -> list[Row]:
    """Rows of the state size of every method, and of the memory that a million samples add to the process."""
    rows = []
    for method in METHODS:
        device = device_for(method)
        estimator = estimator_for(device, method)
        size = estimator.init().nbytes / 1024.0
        rows.append(Row(f"memory.{method}.state", f"{method}: state", "size [KiB]", None, size, None, device.name))
    default = ModulatedTorque.from_device(load_device("qbmove_a"))
    state, _ = default.run_rows(moving_rows(default, FOLDED))
    gc.collect()
    before, peak = resident(), peak_resident()
    for begin in range(FOLDED, FOLDED + LONG, FOLDED):
        state, _ = default.run_rows(moving_rows(default, FOLDED, begin), state)
    for what, grown in (("resident", resident() - before), ("peak", peak_resident() - peak)):
        added = f"{what} memory added by {LONG} samples"
        rows.append(Row(f"memory.growth.{what}", added, "size [KiB]", None, grown / 1024.0, 1024.0,
                        f"modulated_torque on qbmove_a, {FOLDED} samples per call"))  # fmt: skip
    return rows


def resident() -> int:
    """Resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def peak_resident() -> int:
    """Peak resident memory of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
