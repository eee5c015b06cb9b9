"""Reports whose repairs are exported: of sealed cases and of real robots.

Keys of sealed cases are not opened, but for their seeds: the question is the export, not the diagnosis.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from via_core.devices import Device, load_device
from via_core.errors import ViaError
from via_core.text_files import read_text
from via_gap.logs.log import JointLog, read_logs
from via_gap.report.report import GapReport, read_report

from via_validation.gap_real.cases import CASES, Case
from via_validation.gap_real.run import Recordings, missing, stored
from via_validation.sealed.sealing import DEVICE, logs_in, names_in

Group = Literal["sealed", "real"]


@dataclass(frozen=True)
class Source:
    """A report that states a gap, with its recordings.

    read  the device, and the recordings on which the gap was measured
    """

    name: str
    group: Group
    report: GapReport
    read: Callable[[], tuple[Device, Sequence[JointLog]]]


def sealed_sources(cases: Path, results: Path) -> list[Source]:
    """The cases with a report that states a gap. Raises ViaError if there is none."""
    found = []
    for name in names_in(cases):
        file = results / f"{name}.json"
        if file.exists() and (report := read_report(read_text(file), str(file))).gap is not None:
            found.append(Source(name, "sealed", report, _reader_of_case(cases / name)))
    if not found:
        raise ViaError(f"{results} has no report of the cases in {cases} that states a gap")
    return found


def _reader_of_case(folder: Path) -> Callable[[], tuple[Device, Sequence[JointLog]]]:
    def read() -> tuple[Device, Sequence[JointLog]]:
        device = load_device(folder / DEVICE)
        return device, read_logs(logs_in(folder), device)

    return read


def real_sources(results: Path, data: Path) -> list[Source]:
    """The real robots whose recordings are in `data`, and whose stored result has a report that states a gap."""
    found = []
    for case in CASES:
        result = stored(case, results)
        report = None if result is None else result.report
        if report is not None and report.gap is not None and not missing(case, data):
            found.append(Source(case.name, "real", report, _reader_of_robot(case, data, report)))
    return found


def _reader_of_robot(case: Case, data: Path, report: GapReport) -> Callable[[], tuple[Device, Sequence[JointLog]]]:
    wanted = {each.log for each in report.held_out}

    def read() -> tuple[Device, Sequence[JointLog]]:
        with TemporaryDirectory() as bags:
            recordings = Recordings(case, data, Path(bags))
            logs = [log for log in recordings((*case.fitted, *case.held_out)) if log.name in wanted]
        return (logs[0].device if case.arm else recordings.device), logs

    return read


def seeds_of(names: Sequence[str], keys: Path) -> tuple[int, int]:
    """Least and largest seed of sealed cases. Raises ViaError if a key cannot be read."""
    try:
        seeds = [int(json.loads(read_text(keys / f"{name}.json"))["seed"]) for name in names]
    except (KeyError, ValueError) as error:
        raise ViaError(f"{keys}: {error}") from None
    return min(seeds), max(seeds)
