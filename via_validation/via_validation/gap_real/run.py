"""Run one case: read and diagnose its recordings, and try the repair on other recordings of the same robot.

Each result is stored as a JSON file. It is reused while neither the case nor the sources of via_core, via_sim and
via_gap have changed, so that an interrupted run continues where it stopped.
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict
from via_core.bags.importing import import_recordings
from via_core.devices import Device
from via_core.errors import SignalError, ViaError
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport
from via_gap.report.withheld import before_and_after
from via_gap.residual.errors import Errors

from via_validation.gap_real.cases import Case

DECIDING = ("via_core", "via_sim", "via_gap")
TAIL = 0.025  # quantile of the bootstrap for a two-sided 95 % interval
Progress = Callable[[str, float], None]


class Elsewhere(BaseModel):
    """The gap on another recording; `ratio`: 95 % interval of after over before by the block bootstrap."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: str
    before: float
    after: float
    ratio: tuple[float, float]
    failure: str = ""  # why the recording cannot be compared

    @property
    def worse(self) -> bool:
        """Whether the repair increases the gap significantly."""
        return self.ratio[0] > 1.0


class Result(BaseModel):
    """Result of one case; `report` is None if the diagnosis failed, and `failure` states the error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    case: str
    key: str
    seconds: float  # of processor time
    report: GapReport | None
    elsewhere: tuple[Elsewhere, ...] = ()
    failure: str = ""


def run_case(case: Case, data: Path, progress: Progress) -> Result:
    """Diagnose a case from the data folder. An exception of the diagnosis becomes the result's `failure`."""
    began = time.process_time()
    report, elsewhere, failure = None, [], ""
    with tempfile.TemporaryDirectory() as bags:
        try:
            read = Recordings(case, data, Path(bags))
            fitted, held_out, others = (read(each) for each in (case.fitted, case.held_out, case.others))
            report = diagnose(
                fitted, read.device, held_out or None, lambda what, share: progress(what, 0.9 * share), read.groups(),
                only_equations=bool(case.arm),
            )  # fmt: skip
            took = time.process_time() - began
            progress("comparing other recordings", 0.9)
            elsewhere = _elsewhere(case, report, read.device, others)
        except Exception as error:  # a crash counts as a miss and must not end the other cases
            took = time.process_time() - began
            failure = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return Result(
        case=case.name, key=key(case), seconds=took, report=report, elsewhere=tuple(elsewhere), failure=failure
    )


def missing(case: Case, data: Path) -> str:
    """The first missing recording or folder of the case; empty if all are present."""
    folder = data / case.folder
    if not folder.is_dir():
        return f"no folder {case.folder}"
    names = [str(path.relative_to(folder)) for path in folder.rglob("*.csv")]
    wanted = (*case.fitted, *case.held_out, *case.others)
    absent = [each for each in wanted if not any(fnmatch(name, each) for name in names)]
    return f"no {case.folder}/{absent[0]}" if absent else ""


def kept(case: Case, folder: Path) -> Result | None:
    """The stored result of a case, failures included; None if it is missing or out of date."""
    result = stored(case, folder)
    return result if result is not None and result.key == key(case) else None


def stored(case: Case, folder: Path) -> Result | None:
    """The stored result of a case, whatever made it; None if there is none."""
    try:
        return Result.model_validate_json((folder / f"{case.name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def keep(result: Result, folder: Path) -> None:
    """Store a result atomically. Raises ViaError if the folder is not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = folder / f"{result.case}.json.unfinished"
        unfinished.write_text(result.model_dump_json(indent=1), encoding="utf-8")
        unfinished.replace(folder / f"{result.case}.json")
    except OSError as error:
        raise ViaError(f"cannot write into {folder}: {error.strerror}") from None


def key(case: Case) -> str:
    """Hash of everything that the result depends on; the documented truth and the aim do not affect it."""
    computed = replace(case, truth=None, aim=0.0)  # type: ignore[arg-type]
    return sha256(f"{computed} {digest_of_sources(DECIDING)}".encode()).hexdigest()[:16]


@cache
def digest_of_sources(packages: tuple[str, ...]) -> str:
    """Hash of the sources of packages."""
    digest = sha256()
    for package in packages:
        root = Path(str(files(package)))
        for path in sorted(each for each in root.rglob("*") if each.suffix in (".py", ".yaml", ".urdf")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


class Recordings:
    """Reader of a case's recordings by patterns of file names.

    device   nominal device
    sources  name of each log read so far -> its file
    """

    def __init__(self, case: Case, data: Path, bags: Path) -> None:
        self.device: Device = case.nominal()
        self.sources: dict[str, str] = {}
        self._case = case
        folder = data / case.folder
        if case.imported:
            imported = import_recordings(folder, case.device, bags).files
            self._files = {each.source: each.bag for each in imported if each.bag is not None}
        else:
            self._files = {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*.csv"))}

    def __call__(self, patterns: Sequence[str]) -> list[JointLog]:
        """The logs whose files match a pattern."""
        found = [name for pattern in patterns for name in self._files if fnmatch(name, pattern)]
        logs = [self._read(Path(self._files[name])) for name in found]
        self.sources.update({log.name: name for log, name in zip(logs, found, strict=True)})
        return logs

    def groups(self) -> dict[str, str] | None:
        """Name of a log -> its group; None for a case without groups."""
        if not self._case.group:
            return None
        found = {name: re.search(self._case.group, source) for name, source in self.sources.items()}
        return {name: match[1] for name, match in found.items() if match is not None}

    def _read(self, path: Path) -> JointLog:
        if not self._case.arm:
            return read_log(path, self.device)
        from via_gap.run.arm_model import load_arm  # pinocchio takes a second to load
        from via_gap.run.arms import read_arm_log

        arm = load_arm(self._case.arm)
        return next(log for log in read_arm_log(path, arm) if log.device.name == self.device.name)


def _elsewhere(case: Case, report: GapReport, device: Device, logs: Sequence[JointLog]) -> list[Elsewhere]:
    """The gap of other recordings without and with the repair, measured as in the report."""
    if report.gap is None or not report.repaired() or not logs:
        return []
    if case.imported:
        return [_compared(case, report, device, list(logs), f"{len(logs)} recordings")]
    return [_compared(case, report, device, [log], log.name) for log in logs]


def _compared(case: Case, report: GapReport, device: Device, logs: list[JointLog], name: str) -> Elsewhere:
    assert report.gap is not None
    logs = report.as_read(logs)
    try:
        if report.gap.by == "inverse dynamics":
            before, after = before_and_after(logs, logs[0].device, report.repaired(), only_equations=True)
        else:
            before, after = before_and_after(logs, device, report.repaired())
    except SignalError as error:
        return Elsewhere(log=name, before=0.0, after=0.0, ratio=(0.0, 0.0), failure=str(error))
    return Elsewhere(log=name, before=before.overall, after=after.overall, ratio=_ratio(before, after))


def _ratio(before: Errors, after: Errors) -> tuple[float, float]:
    """95 % interval of the ratio of the errors; both are resampled with the same blocks."""
    ratios = after.resampled() / np.maximum(before.resampled(), 1e-12)
    low, high = np.quantile(ratios, [TAIL, 1.0 - TAIL])
    return float(low), float(high)
