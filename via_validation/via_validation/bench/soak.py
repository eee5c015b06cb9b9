"""Endurance test: an estimator on one joint for simulated hours at 1 kHz, with its state carried from chunk to chunk.

The joint's motion, ten minutes with two stops and two minutes of rest at the end, is simulated once and repeated;
noise, encoder steps, dropouts and gaps are new in every repetition. Required are finite numbers, bounded
standard deviations, an error in the last hour not much larger than in the first, and constant memory of the process.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from pathlib import Path
from time import perf_counter

import numpy as np
from via_controllers.multisine import Multisine
from via_core.device_parts import Observed
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.contract import Estimator, rows_of
from via_estimators.methods import estimator_for
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import simulate

from via_validation.bench.estimators import resident
from via_validation.provenance import Provenance
from via_validation.side_by_side import Send
from via_validation.tables.page import number
from via_validation.tables.rows import Row
from via_validation.template import rendered

RATE = 1000.0  # [Hz]
PERIOD = 600.0  # [s] after which the motion repeats
STOPS = ((100.0, 107.0), (250.0, 310.0), (480.0, 600.0))  # [s] without motion
FADE = 1.0  # [s] of smooth transition into and out of a stop
CHUNK = 60.0  # [s] processed at once
HOUR = 3600.0
LOST = 0.02  # share of seconds with a burst of invalid samples
BURST = 20  # samples
GAP = (0.06, 2.0)  # [s] range of the gap in every chunk; a gap of the longest length separates two periods
LOAD = 0.25  # spring torque over that at the deflection limit
DRIFT_LIMIT, SD_LIMIT = 1.25, 1.5  # over the first hour: error of the last, standard deviation of any
GROWTH_LIMIT = 4096.0  # [KiB]
Progress = Callable[[float, float, str], None]


@dataclass(frozen=True)
class Motion:
    """One period: rows (N, 1 + k) without noise, noise and steps of each column (k,), truth of the output (N,)."""

    rows: Array
    noise: Array
    quantum: Array
    truth: Array
    output: str


@dataclass(frozen=True)
class Hour:
    """Results of one hour; the error is a relative RMS over samples with status OK."""

    samples: int
    error: float
    sd: float  # RMS standard deviation of the output, status OK
    largest_sd: float  # largest standard deviation of the output, any status
    shares: dict[str, float]  # of the samples, by status
    condition: float
    resident: int  # [bytes] at its end
    finite: bool


@dataclass(frozen=True)
class Endurance:
    """Results of a whole run."""

    method: str
    device: str
    start: float  # [s] stamp of the first sample
    hours: tuple[Hour, ...]
    seconds: float  # wall time


@dataclass(frozen=True)
class Scenario:
    """Stamp of the first sample [s], seed of noise, dropouts and gaps, and period of the motion [s]."""

    start: float = 0.0
    seed: int = 0
    period: float = PERIOD


def moving(time: Array) -> Array:
    """Amplitude (N,) of the motion at `time` [s] of a period: 1 in motion, 0 in a stop, smooth in between."""
    share = np.ones(len(time))
    for begin, end in ((-1.0, 0.0), *STOPS):
        outside = np.clip(np.maximum(begin - time, time - end) / FADE, 0.0, 1.0)
        share = np.minimum(share, outside * outside * (3.0 - 2.0 * outside))
    return share


def motion_of(device: Device, method: str, period: float = PERIOD) -> Motion:
    """The joint's motion under multisine commands. Raises ParameterError for an unsupported arrangement or drive."""
    time = np.arange(round(period * RATE)) / RATE
    share = moving(time)

    def tones(mean: float, *pairs: tuple[float, float]) -> Array:
        found = Multisine(0.0, tuple(a for a, _ in pairs), tuple(f for _, f in pairs))
        return mean + share * np.array([found.at(t) for t in time])

    names = {"damping": np.full(len(time), 0.5)} if device.damper is not None else {}
    if device.drive == "servo" and device.arrangement == "serial":
        names |= {"equilibrium": tones(0.0, (0.5, 0.9), (0.3, 2.1)), "preset": tones(0.8, (0.4, 0.3))}
    elif device.arrangement == "rigid":
        names |= {"external_torque": tones(0.0, (4.0, 0.5), (2.0, 1.3))}
    elif device.drive == "torque" and device.n_transmissions == 2:
        load = LOAD * float(device.spring_laws[0].torque(device.spring_laws[0].max_deflection))
        first = tones(1.0, (0.5, 0.7), (0.25, 1.9))
        second = tones(1.0, (0.5, 1.1), (0.25, 2.3))
        names |= {"motor": np.column_stack([load * first, -load * second])}
    else:
        raise ParameterError(f"no motion defined for '{device.name}': {device.arrangement}, {device.drive} drive")
    commands = Signals(time, names, dict.fromkeys(names, "-"), frozenset(names))
    run = simulate(JointPlant.from_device(device), commands, period - 1.0 / RATE, RATE, sensors=IDEAL)
    estimator = estimator_for(device, method)
    output = "stiffness" if "stiffness" in estimator.outputs else "damping"
    channels = {**run.measured.channels, **{n: v for n, v in names.items() if n in ("equilibrium", "preset")}}
    rows = rows_of(Signals(run.measured.time, channels, dict.fromkeys(channels, "-")), estimator.inputs)
    noise, quantum = _sensors(device, estimator.inputs)
    return Motion(rows, noise, quantum, run.truth[output], output)


def _sensors(device: Device, inputs: Sequence[str]) -> tuple[Array, Array]:
    """Noise and steps of every column from the device file; defaults: .01 N m for torques, .01 rad/s for velocities."""
    noise, quantum = np.zeros(len(inputs)), np.zeros(len(inputs))
    for at, name in enumerate(inputs):
        if name == "q":
            quantum[at] = device.sensors.link_quantum or 0.0
        elif name.startswith("theta_velocity"):
            noise[at] = 0.01
        elif name.startswith("theta"):
            quantum[at] = device.sensors.motor_quantum or 0.0
        elif name.startswith("tau"):
            noise[at] = device.sensors.link_torque_noise or device.sensors.torque_noise or 0.01
        noise[at] = max(noise[at], quantum[at] / 2.0)
    return noise, quantum


def measured(motion: Motion, begin: int, end: int, shift: float, random: np.random.Generator) -> tuple[Array, Array]:
    """Rows and truth of samples begin..end of the period, `shift` [s] later, with noise, invalid samples and a gap."""
    rows = motion.rows[begin:end].copy()
    truth = motion.truth[begin:end]
    values = rows[:, 1:]
    values += motion.noise * random.standard_normal(values.shape)
    stepped = motion.quantum > 0.0
    values[:, stepped] = np.round(values[:, stepped] / motion.quantum[stepped]) * motion.quantum[stepped]
    for first in np.flatnonzero(random.random(len(rows) // round(RATE)) < LOST) * round(RATE):
        values[first : first + BURST, random.integers(values.shape[1])] = random.choice([np.nan, np.inf, 1e12])
    rows[:, 0] += shift
    hole = random.integers(len(rows))
    kept = np.ones(len(rows), dtype=bool)
    kept[hole : hole + round(random.uniform(*GAP) * RATE)] = False
    return rows[kept], truth[kept]


def soak(device: Device, method: str, hours: float, progress: Progress, scenario: Scenario | None = None) -> Endurance:
    """Run the method for `hours` of simulated time."""
    scenario = scenario or Scenario()
    device = device.model_copy(
        update={"observed": Observed(), "sensors": device.sensors.model_copy(update={"rate": RATE})}
    )
    estimator, motion = estimator_for(device, method), motion_of(device, method, scenario.period)
    random, began = np.random.default_rng(scenario.seed), perf_counter()
    found: list[Hour] = []
    parts: list[_Part] = []
    state, elapsed, at, shift, mark = estimator.init(), 0.0, 0, scenario.start, HOUR
    while elapsed < hours * HOUR:
        end = min(at + round(CHUNK * RATE), len(motion.rows))
        rows, truth = measured(motion, at, end, shift, random)
        state, part = _take(estimator, state, rows, truth, motion.output)
        parts.append(part)
        elapsed += (end - at) / RATE
        at = end
        if at == len(motion.rows):
            at, shift = 0, shift + scenario.period + GAP[1]
        if elapsed >= min(mark, hours * HOUR):
            gc.collect()
            found.append(_hour(parts, estimator.condition(state)))
            parts, mark = [], mark + HOUR
        progress(elapsed / HOUR, hours, method)
    return Endurance(method, device.name, scenario.start, tuple(found), perf_counter() - began)


def work(device: Device, method: str, hours: float, start: float, seed: int, send: Send) -> None:
    """One run as a job of `side_by_side`: sends the hours done, and finally the Endurance or the error."""
    try:
        send(soak(device, method, hours, lambda done, _of, _name: send(done), Scenario(start, seed)))
    except ParameterError as error:
        send(error)


@dataclass(frozen=True)
class _Part:
    """Sums of one chunk."""

    counts: np.ndarray  # by status
    error: float
    truth: float
    variance: float
    largest_sd: float
    finite: bool


def _take(estimator: Estimator, state: Array, rows: Array, truth: Array, output: str) -> tuple[Array, _Part]:
    state, estimates = estimator.run_rows(rows, state)
    value, sd = estimates.column(output)
    ok = estimates.status == Status.OK
    finite = all(bool(np.isfinite(part).all()) for part in (estimates.value, estimates.standard_deviation, state))
    counts = np.bincount(estimates.status, minlength=len(Status))
    error, size = float(np.sum((value - truth)[ok] ** 2)), float(np.sum(truth[ok] ** 2))
    variance = float(np.sum(sd[ok] ** 2))
    return state, _Part(counts, error, size, variance, float(sd.max()), finite)


def _hour(parts: Sequence[_Part], condition: float) -> Hour:
    counts = sum((part.counts for part in parts), np.zeros(len(Status)))
    size = sum(part.truth for part in parts)
    return Hour(
        samples=int(counts.sum()),
        error=sqrt(sum(part.error for part in parts) / size) if size > 0.0 else inf,
        sd=sqrt(sum(part.variance for part in parts) / max(counts[Status.OK], 1.0)),
        largest_sd=max(part.largest_sd for part in parts),
        shares={status.name: float(counts[status] / counts.sum()) for status in Status},
        condition=condition,
        resident=resident(),
        finite=all(part.finite for part in parts),
    )


def soak_rows(run: Endurance) -> list[Row]:
    """Rows of the requirements, with their limits."""
    first, last = run.hours[0], run.hours[-1]
    hours = f"{len(run.hours)} h on {run.device} from stamp {run.start:g} s"
    later = run.hours[1:] or run.hours  # the first hour starts from the prior

    def row(name: str, what: str, quantity: str, ours: float, limit: float | None) -> Row:
        return Row(f"soak.{run.method}.{name}", what, quantity, None, ours if isfinite(ours) else None, limit, hours)

    return [
        row("not_finite", "hours with a number that is not finite", "count", sum(not h.finite for h in run.hours), 0.0),
        row("error.first", "relative RMS error, first hour", "error [%]", 100.0 * first.error, None),
        row("error.last", "relative RMS error, last hour", "error [%]", 100.0 * last.error,
            100.0 * DRIFT_LIMIT * first.error),
        row("sd", "RMS standard deviation, largest of the later hours over the first", "ratio [-]",
            max(hour.sd for hour in later) / max(first.sd, 1e-300), SD_LIMIT),
        row("widest", "largest standard deviation of any sample, largest of the later hours over the first",
            "ratio [-]", max(hour.largest_sd for hour in later) / max(first.largest_sd, 1e-300), SD_LIMIT),
        row("memory", "memory of the process, last hour less the first", "size [KiB]",
            (last.resident - first.resident) / 1024.0, GROWTH_LIMIT),
        row("condition", "largest condition number at the end of an hour", "[-]",
            max(hour.condition for hour in run.hours), None),
        *(row(f"status.{name.lower()}", f"samples of the last hour: {name}", "share [%]", 100.0 * share, None)
          for name, share in last.shares.items()),
        row("speed", "simulated time over time taken", "ratio [-]",
            sum(hour.samples for hour in run.hours) / RATE / run.seconds, None),
    ]  # fmt: skip


def write_markdown(runs: Sequence[Endurance], missing: Sequence[str], source: Provenance, path: Path) -> None:
    """Write all runs as a Markdown page, with the names of the methods whose result is missing."""
    missed = [row.id for run in runs for row in soak_rows(run) if row.ok is False]
    values = {
        "runs": [_cells(run) for run in runs],
        "statuses": [status.name for status in Status],
        "lost": LOST,
        "drift": DRIFT_LIMIT,
        "sd": SD_LIMIT,
        "growth": GROWTH_LIMIT,
        "missed": f"Missed: {', '.join(missed)}." if missed else "No limit is missed.",
        "missing": missing,
        "source": source,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(rendered("bench/soak.md", values), encoding="utf-8")


def _cells(run: Endurance) -> list[str]:
    last, rows = run.hours[-1], {row.id.removeprefix(f"soak.{run.method}."): row for row in soak_rows(run)}
    finite = "yes" if all(hour.finite for hour in run.hours) else "**no**"
    names = ("error.first", "error.last", "sd", "widest", "memory", "condition")
    return [
        run.method,
        run.device,
        f"{sum(hour.samples for hour in run.hours) / RATE / HOUR:.3g}",
        f"{run.start:g}",
        finite,
        *(number(rows[name].ours) for name in names),
        *(f"{100.0 * share:.2f}" for share in last.shares.values()),
        f"{rows['speed'].ours or 0.0:.0f}",
    ]
