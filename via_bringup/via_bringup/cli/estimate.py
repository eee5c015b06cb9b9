"""`via estimate BAG`: a recorded bag through the estimator, without ROS, bit for bit what its node would publish."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from via_core.bags import read_bag
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.status import Status
from via_estimators.methods import estimator_for, method_for
from via_estimators.rows import BagEstimates, estimate_bag

from via_bringup.cli.console import answers, errors, table

UNITS = {"stiffness": "N m/rad", "motor_inertia": "kg m^2", "motor_damping": "N m s/rad", "damping": "N m s/rad"}


def estimate(
    bag: Annotated[Path, typer.Argument(help="Bag folder or .mcap file.")],
    device: Annotated[str, typer.Option(help="Device name (see `via devices`) or path to its YAML.")],
    method: Annotated[str, typer.Option(help="Estimator; auto: what suits the device's drive.")] = "auto",
    joint_topic: Annotated[str, typer.Option(help="Topic of the joint states.")] = "/joint_states",
    out: Annotated[Path | None, typer.Option("--csv", help="Write every estimate to this CSV file.")] = None,
) -> None:
    """Estimate stiffness and damping from a bag and print where they ended."""
    described = load_device(device)
    read = read_bag(bag)
    for remark in read.remarks:
        errors.print(f"note: {remark}")
    estimator = estimator_for(described, method)
    done = estimate_bag(read, described, estimator, joint_topic)
    for complaint in (*read[joint_topic].left_out, *_missing(done, estimator.inputs)):
        errors.print(f"note: {complaint}")
    estimates = done.estimates
    counts = {status: int(np.count_nonzero(estimates.status == status)) for status in Status}
    trusted = np.flatnonzero(estimates.status == Status.OK)
    shown = table(
        f"{bag.name}: {len(estimates)} samples, {method_for(described, method)}", "estimate", "value", "sd", "unit"
    )
    if len(trusted):
        for name in estimates.outputs:
            value, deviation = estimates.column(name)
            shown.add_row(name, f"{value[trusted[-1]]:.6g}", f"{deviation[trusted[-1]]:.2g}", _unit(name))
        answers.print(shown)
        answers.print(f"last trusted sample at {estimates.time[trusted[-1]]:.3f} s")
    else:
        answers.print("no sample of this bag gives a trusted estimate")
    answers.print("samples by status: " + ", ".join(f"{status.name} {n}" for status, n in counts.items() if n))
    if out is not None:
        _write(out, done)
        answers.print(f"wrote {out}")


def _missing(done: BagEstimates, inputs: tuple[str, ...]) -> list[str]:
    """What the samples lack, one sentence per input; a message without the value counts as well as a NaN."""
    rows = done.samples.rows[:, 1:]
    shares = np.mean(~np.isfinite(rows), axis=0) if len(rows) else np.ones(len(inputs))
    constant = [len(rows) > 1 and bool(np.all(column == column[0])) for column in rows.T]
    lacking = [
        f"{name} is in none of the messages"
        if share == 1.0
        else f"{name} is missing in {100 * share:.1f} % of the samples"
        for name, share in zip(inputs, shares, strict=True)
        if share > 0.0
    ]
    dead = [
        f"{name} never changes: is it measured at all?"
        for name, still in zip(inputs, constant, strict=True)
        if still and name.startswith("tau_")
    ]
    return lacking + dead


def _unit(output: str) -> str:
    return UNITS.get(output.rstrip("_0123456789"), "-")


def _write(path: Path, done: BagEstimates) -> None:
    """One line per sample: stamp [ns], status, then value and standard deviation of every output, exact."""
    estimates = done.estimates
    names = [f"{name}{what}" for name in estimates.outputs for what in ("", "_standard_deviation")]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["stamp_ns", "status", *names])
            for k in range(len(estimates)):
                pairs = np.stack([estimates.value[k], estimates.standard_deviation[k]], axis=1).ravel()
                writer.writerow(
                    [int(done.samples.stamp[k]), Status(int(estimates.status[k])).name, *map(repr, pairs.tolist())]
                )
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
