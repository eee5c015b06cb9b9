"""The real robot: damping of the MACCEPA-VD from its own motion, held against the damping it was commanded.

Every run whose recording can be true goes through the device's default estimator, sample by sample as a node would do
it but in this process. The reference is what the device file's damper map makes of the logged command, plus the
published friction of the joint: a published model, not a measurement. No estimator was tuned on these numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from via_bringup.demo.pictures import Column, by_strategy
from via_bringup.demo.recordings import recordings
from via_core.bags.importing import import_recordings
from via_core.bags.reader import read_bag
from via_core.devices import Device, load_device
from via_core.metrics import WIDTH_95
from via_core.status import Status
from via_estimators.contract import Estimator, summarise
from via_estimators.methods import estimator_for
from via_estimators.rows import estimate_bag

from via_validation.tables.rows import Progress, Row

DEVICE = MAPPING = "maccepavd"
PERCENT = 100.0


@dataclass(frozen=True)
class JudgedRun:
    """One run in one number: damping estimated and commanded [N m s/rad], averaged with the same weights."""

    strategy: str
    value: float
    deviation: float
    command: float
    samples_outside: float  # [-] share of OK estimates whose own 95 % interval misses the command of their time

    @property
    def error(self) -> float:
        return self.value - self.command

    @property
    def covered(self) -> bool:
        """Whether the run's 95 % interval holds the command."""
        return abs(self.error) <= WIDTH_95 * self.deviation


@dataclass(frozen=True)
class JudgedRuns:
    """All good runs of a folder."""

    source: str
    runs: tuple[JudgedRun, ...]
    refused: int
    unexcited: int  # good recordings without any estimate that counts

    def of(self, strategy: str) -> tuple[JudgedRun, ...]:
        """The runs of one strategy, of all for 'all'."""
        return tuple(run for run in self.runs if strategy in ("all", run.strategy))

    @property
    def strategies(self) -> tuple[str, ...]:
        return tuple(sorted({run.strategy for run in self.runs}))


def judge(
    estimator: Estimator,
    progress: Progress,
    keep: Callable[[str], bool] = lambda name: True,
    data: Path | None = None,
) -> JudgedRuns:
    """Every good run of the folder `data` through `estimator`; `keep` chooses by the bag's name ('vardamp_traj3_2')."""
    device = load_device(DEVICE)
    with recordings(data) as (folder, source), TemporaryDirectory() as scratch:
        imported = import_recordings(folder, MAPPING, Path(scratch) / "bags")
        bags = [file.bag for file in imported.accepted if file.bag is not None and keep(file.bag.name)]
        found = []
        for number, bag in enumerate(bags):
            progress(number, len(bags), bag.name)
            found.append(_judged(device, estimator, bag))
    runs = tuple(run for run in found if run is not None)
    return JudgedRuns(source, runs, len(imported.refused), len(found) - len(runs))


def _judged(device: Device, estimator: Estimator, bag: Path) -> JudgedRun | None:
    parts = re.fullmatch(r"([a-z]+)_traj(\d+)_(\d+)", bag.name)
    assert parts is not None  # the mapping names bags so
    samples, estimates = estimate_bag(read_bag(bag), device, estimator)
    good = estimates.status == Status.OK
    if not good.any():
        return None
    command = device.link.viscous_friction + device.damping_of(samples.damping_command)
    value, deviation, weights = summarise(estimates, "damping")
    values, deviations = estimates.column("damping")
    outside = np.abs(values - command)[good] > WIDTH_95 * deviations[good]
    return JudgedRun(parts[1], value, deviation, float(weights[good] @ command[good]), float(np.mean(outside)))


def rows(seeds: int, progress: Progress, data: Path | None = None) -> list[Row]:
    """Errors and coverage per strategy and of all runs; `seeds` is not needed, the robot made the noise."""
    judged = judge(estimator_for(load_device(DEVICE)), progress, data=data)
    settings = (
        f"{judged.source}: {len(judged.runs)} runs, {judged.refused} recordings refused, {judged.unexcited} without an "
        "estimate; link_impedance with the device file's numbers; a run counts as one information-weighted mean"
    )
    return [row for name in (*judged.strategies, "all") for row in _rows_of(name, judged.of(name), settings)]


def _rows_of(name: str, runs: Sequence[JudgedRun], settings: str) -> list[Row]:
    error = np.abs([run.error for run in runs])
    relative = error / np.array([run.command for run in runs])
    deviation = np.array([run.deviation for run in runs])
    numbers = (
        ("runs", "good runs", "number of runs [-]", float(len(runs))),
        ("median", "median error", "|estimate - command| [N m s/rad]", float(np.median(error))),
        ("mean", "mean error", "|estimate - command| [N m s/rad]", float(np.mean(error))),
        ("median_relative", "median relative error", "|estimate / command - 1| [%]",
         PERCENT * float(np.median(relative))),
        ("mean_relative", "mean relative error", "|estimate / command - 1| [%]", PERCENT * float(np.mean(relative))),
        ("bias", "mean of estimate - command", "[N m s/rad]", float(np.mean([run.error for run in runs]))),
        ("deviation", "standard deviation reported, median", "[N m s/rad]", float(np.median(deviation))),
        ("coverage", "runs whose 95 % interval holds the command", "share [%]",
         PERCENT * float(np.mean([run.covered for run in runs]))),
        ("sample_coverage", "single estimates whose 95 % interval holds the command of their time", "share [%]",
         PERCENT * (1.0 - float(np.mean([run.samples_outside for run in runs])))),
    )  # fmt: skip
    words = "all strategies" if name == "all" else f"strategy {name}"
    return [Row(f"robot.{name}.{key}", f"{words}: {what}", quantity, None, ours, None, settings)
            for key, what, quantity, ours in numbers]  # fmt: skip


def pictures(folder: Path, progress: Progress, data: Path | None = None) -> list[Path]:
    """Estimate with its 95 % interval against the command, run by run and strategy by strategy."""
    judged = judge(estimator_for(load_device(DEVICE)), progress, data=data)
    columns = {
        name: Column(
            np.array([run.value for run in judged.of(name)]),
            np.array([run.deviation for run in judged.of(name)]),
            float(np.mean([run.command for run in judged.of(name)])),
        )
        for name in judged.strategies
    }
    path = folder / "damping.png"
    by_strategy(columns, "damping [N m s/rad]", "commanded, weighted as the estimates are", path)
    return [path]
