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
from via_core.device_parts import Observed
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import Status
from via_estimators.contract import Estimator
from via_estimators.methods import estimator_for

from via_validation.bench.estimators import resident
from via_validation.bench.soak_motion import GAP, LOST, PERIOD, RATE, measured, motion_of
from via_validation.provenance import Provenance
from via_validation.side_by_side import Send
from via_validation.tables.page import number
from via_validation.tables.rows import Row
from via_validation.template import write_page

CHUNK = 60.0  # [s] processed at once
HOUR = 3600.0
DRIFT_LIMIT, SD_LIMIT = 1.25, 1.5  # over the first hour: error of the last, standard deviation of any
GROWTH_LIMIT = 4096.0  # [KiB]
Progress = Callable[[float, float, str], None]


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
    write_page(path, "bench/soak.md", values)


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
