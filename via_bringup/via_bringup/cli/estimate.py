"""`via estimate LOG`: run estimators on a recording without ROS.

From a bag they equal the node's bit for bit, if its samples come at the rate of the device file; a node cannot know it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from via_core.bags.reader import Bag, read_bag
from via_core.bags.recording_checks import rate_remark, sampling_rate
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.recordings.channels import joint_of
from via_core.recordings.tables import Tables, is_bag, read_tables
from via_core.status import Status
from via_estimators.contract import Estimates
from via_estimators.methods import Pair, estimator_for, pairs_of
from via_estimators.rows import BagEstimates, SampleRows, at_rate, sample_rows, table_rows

from via_bringup.cli.console import answers, errors, print_table, working
from via_bringup.cli.outputs import check_files

UNITS = {"stiffness": "N m/rad", "motor_inertia": "kg m^2", "motor_damping": "N m s/rad", "damping": "N m s/rad"}


def estimate(
    log: Annotated[Path, typer.Argument(help="Bag, CSV, Parquet, NumPy, MATLAB or JSON file.")],
    device: Annotated[
        list[str], typer.Option(help="Device name (see `via devices`) or path to its YAML; repeat for several.")
    ],
    method: Annotated[
        list[str] | None, typer.Option(help="Estimator name, all, or auto (the default); repeat for several.")
    ] = None,
    joint_topic: Annotated[str, typer.Option(help="Topic of the joint states of a bag.")] = "/joint_states",
    out: Annotated[
        Path | None, typer.Option("--csv", help="Write all estimates to this CSV file, or one file per estimator.")
    ] = None,
) -> None:
    """Estimate stiffness and damping from a bag or a table and print the last values."""
    check_files(out)
    pairs = pairs_of([load_device(each) for each in device], method or ["auto"])
    source = _Source(log, joint_topic)
    results: list[tuple[Pair, BagEstimates]] = []
    with working(f"estimating from {log.name}") as progress:
        for pair in pairs:
            progress(f"{pair.device.name} by {pair.method}", len(results) / len(pairs))
            results.append((pair, source.estimates(pair)))
    lacking = [f"{pair.device.name}: {what}" for pair, each in results for what in _missing(each, _inputs(pair))]
    for complaint in dict.fromkeys([*source.remarks, *lacking]):
        errors.print(f"note: {complaint}")
    columns = ("device", "method", "estimate", "value", "sd", "unit", "last trusted at [s]")
    print_table(log.name, columns, (row for pair, each in results for row in _last(pair, each.estimates)), names=3)
    statuses = (status.name for status in Status)
    rows = []
    for pair, (_, estimates) in results:
        shares = [float(np.mean(estimates.status == status)) if len(estimates) else 0.0 for status in Status]
        percentages = (f"{100.0 * share:.1f} %" for share in shares)
        rows.append((pair.device.name, pair.method, str(len(estimates)), *percentages))
    print_table("samples by status", ("device", "method", "samples", *statuses), rows, names=2)
    if out is not None:
        for pair, each in results:
            path = out if len(results) == 1 else out.with_stem(f"{out.stem}_{pair.device.name}_{pair.method}")
            _write(path, each)
            answers.print(f"wrote {path}")


@dataclass
class _Source:
    """A recording, read once for all estimators: messages of a bag by joint name, tables by `wire.columns`."""

    path: Path
    joint_topic: str
    remarks: list[str] = field(default_factory=list)

    @cached_property
    def bag(self) -> Bag:
        read = read_bag(self.path)
        self.remarks += [*read.remarks, *read[self.joint_topic].left_out]
        return read

    @cached_property
    def tables(self) -> Tables:
        return read_tables(self.path)

    def estimates(self, pair: Pair) -> BagEstimates:
        """Estimates of a device at the rate of its samples."""
        samples = self._samples(pair)
        rate = sampling_rate(samples.rows[:, 0])
        remark = rate_remark(rate, pair.device)
        if remark:
            self.remarks.append(f"{pair.device.name}: {remark}")
        estimator = estimator_for(at_rate(pair.device, rate), pair.method)
        state, estimates = estimator.run_rows(samples.rows)
        fault = estimator.fault(state)
        if fault:
            self.remarks.append(f"{pair.device.name}: {fault}")
        return BagEstimates(samples, estimates)

    def _samples(self, pair: Pair) -> SampleRows:
        device, inputs, bag = pair.device, _inputs(pair), is_bag(self.path)
        if bag and not device.wire.topics_of_columns:
            return sample_rows(self.bag, device, inputs, self.joint_topic)
        return table_rows(joint_of(self.tables, device, str(self.path), bag), inputs)


def _inputs(pair: Pair) -> tuple[str, ...]:
    return estimator_for(*pair).inputs


def _last(pair: Pair, estimates: Estimates) -> Iterator[tuple[str, ...]]:
    """One row per output with its last trusted estimate, or dashes if there is none."""
    trusted = np.flatnonzero(estimates.status == Status.OK)
    for name in estimates.outputs:
        value, standard_deviation = estimates.column(name)
        if len(trusted):
            at = trusted[-1]
            cells = (f"{value[at]:.6g}", f"{standard_deviation[at]:.2g}", _unit(name), f"{estimates.time[at]:.3f}")
        else:
            cells = ("-", "-", _unit(name), "never")
        yield (pair.device.name, pair.method, name, *cells)


def _missing(result: BagEstimates, inputs: tuple[str, ...]) -> list[str]:
    """One sentence for each input that is missing (NaN or absent) in some samples, or that never changes."""
    rows = result.samples.rows[:, 1:]
    shares = np.mean(~np.isfinite(rows), axis=0) if len(rows) else np.ones(len(inputs))
    constant = [len(rows) > 1 and bool(np.all(column == column[0])) for column in rows.T]
    lacking = [
        f"{name} was not recorded" if share == 1.0 else f"{name} is missing in {100 * share:.3g} % of the samples"
        for name, share in zip(inputs, shares, strict=True)
        if share > 0.0
    ]
    frozen = [
        f"{name} never changes; check that it is measured"
        for name, still in zip(inputs, constant, strict=True)
        if still and name.startswith("tau_")
    ]
    return lacking + frozen


def _unit(output: str) -> str:
    return UNITS.get(output.rstrip("_0123456789"), "-")


def _write(path: Path, result: BagEstimates) -> None:
    """Write one line per sample: stamp [ns], status, value and standard deviation of every output, without rounding."""
    estimates = result.estimates
    names = [f"{name}{what}" for name in estimates.outputs for what in ("", "_standard_deviation")]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["stamp_ns", "status", *names])
            for k, stamp in enumerate(result.samples.stamp):
                pairs = np.stack([estimates.value[k], estimates.standard_deviation[k]], axis=1).ravel()
                writer.writerow([int(stamp), Status(int(estimates.status[k])).name, *map(repr, pairs.tolist())])
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
