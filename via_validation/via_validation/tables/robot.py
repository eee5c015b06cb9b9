"""Real robot: estimated damping of the MACCEPA-VD compared with the commanded damping.

Every accepted recording is processed by the device's default estimator, sample by sample as in a node. The reference is
a published model, not a measurement: the device file's damper map of the logged command, plus the published friction of
the joint. No estimator was tuned on these numbers.
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
class RunDamping:
    """Estimated and commanded damping [N m s/rad] of one run, averaged with the same weights."""

    strategy: str
    value: float
    sd: float
    command: float
    samples_outside: float  # [-] share of OK estimates whose 95 % interval misses the command at that time

    @property
    def error(self) -> float:
        return self.value - self.command

    @property
    def covered(self) -> bool:
        """Whether the run's 95 % interval contains the command."""
        return abs(self.error) <= WIDTH_95 * self.sd


@dataclass(frozen=True)
class RobotRuns:
    """All accepted runs of a folder."""

    source: str
    runs: tuple[RunDamping, ...]
    refused: int
    unexcited: int  # accepted recordings without an estimate of status OK

    def of(self, strategy: str) -> tuple[RunDamping, ...]:
        """The runs of one strategy; all runs for 'all'."""
        return tuple(run for run in self.runs if strategy in ("all", run.strategy))

    @property
    def strategies(self) -> tuple[str, ...]:
        return tuple(sorted({run.strategy for run in self.runs}))


def robot_runs(
    estimator: Estimator,
    progress: Progress,
    keep: Callable[[str], bool] = lambda name: True,
    data: Path | None = None,
) -> RobotRuns:
    """Damping of all accepted runs in the folder `data`; `keep` selects by the bag's name ('vardamp_traj3_2')."""
    device = load_device(DEVICE)
    with recordings(data) as (folder, source), TemporaryDirectory() as scratch:
        imported = import_recordings(folder, MAPPING, Path(scratch) / "bags")
        bags = [file.bag for file in imported.accepted if file.bag is not None and keep(file.bag.name)]
        found = []
        for number, bag in enumerate(bags):
            progress(number, len(bags), bag.name)
            found.append(_run_damping(device, estimator, bag))
    runs = tuple(run for run in found if run is not None)
    return RobotRuns(source, runs, len(imported.refused), len(found) - len(runs))


def _run_damping(device: Device, estimator: Estimator, bag: Path) -> RunDamping | None:
    parts = re.fullmatch(r"([a-z]+)_traj(\d+)_(\d+)", bag.name)
    assert parts is not None  # the mapping defines these names
    samples, estimates = estimate_bag(read_bag(bag), device, estimator)
    good = estimates.status == Status.OK
    if not good.any():
        return None
    command = device.link.viscous_friction + device.damping_of(samples.damping_command)
    value, sd, weights = summarise(estimates, "damping")
    values, sds = estimates.column("damping")
    outside = np.abs(values - command)[good] > WIDTH_95 * sds[good]
    return RunDamping(parts[1], value, sd, float(weights[good] @ command[good]), float(np.mean(outside)))


def rows(seeds: int, progress: Progress, data: Path | None = None) -> list[Row]:
    """Errors and coverage per strategy and of all runs; `seeds` is unused, since the recordings are real."""
    found = robot_runs(estimator_for(load_device(DEVICE)), progress, data=data)
    settings = (
        f"{found.source}: {len(found.runs)} runs, {found.refused} recordings refused, {found.unexcited} without an "
        "estimate; link_impedance with the device file's numbers; a run counts as one information-weighted mean"
    )
    return [row for name in (*found.strategies, "all") for row in _rows_of(name, found.of(name), settings)]


def _rows_of(name: str, runs: Sequence[RunDamping], settings: str) -> list[Row]:
    error = np.abs([run.error for run in runs])
    relative = error / np.array([run.command for run in runs])
    sd = np.array([run.sd for run in runs])
    numbers = (
        ("runs", "accepted runs", "number of runs [-]", float(len(runs))),
        ("median", "median error", "|estimate - command| [N m s/rad]", float(np.median(error))),
        ("mean", "mean error", "|estimate - command| [N m s/rad]", float(np.mean(error))),
        ("median_relative", "median relative error", "|estimate / command - 1| [%]",
         PERCENT * float(np.median(relative))),
        ("mean_relative", "mean relative error", "|estimate / command - 1| [%]", PERCENT * float(np.mean(relative))),
        ("bias", "mean of estimate - command", "[N m s/rad]", float(np.mean([run.error for run in runs]))),
        ("deviation", "standard deviation reported, median", "[N m s/rad]", float(np.median(sd))),
        ("coverage", "runs whose 95 % interval contains the command", "share [%]",
         PERCENT * float(np.mean([run.covered for run in runs]))),
        ("sample_coverage", "single estimates whose 95 % interval contains the command at that time", "share [%]",
         PERCENT * (1.0 - float(np.mean([run.samples_outside for run in runs])))),
    )  # fmt: skip
    words = "all strategies" if name == "all" else f"strategy {name}"
    return [Row(f"robot.{name}.{key}", f"{words}: {what}", quantity, None, ours, None, settings)
            for key, what, quantity, ours in numbers]  # fmt: skip


def pictures(folder: Path, progress: Progress, data: Path | None = None) -> list[Path]:
    """Picture of the estimates with their 95 % intervals and the command, by run and strategy."""
    found = robot_runs(estimator_for(load_device(DEVICE)), progress, data=data)
    columns = {
        name: Column(
            np.array([run.value for run in found.of(name)]),
            np.array([run.sd for run in found.of(name)]),
            float(np.mean([run.command for run in found.of(name)])),
        )
        for name in found.strategies
    }
    path = folder / "damping.png"
    by_strategy(columns, "damping [N m s/rad]", "commanded, same weights as the estimates", path)
    return [path]
