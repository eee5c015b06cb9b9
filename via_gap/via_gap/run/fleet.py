"""Many logs of one kind of device, diagnosed by many processes through dask.distributed.

rows = run_fleet(paths, device, Path("results"), progress=lambda done, of, path: ...)

Each result is written at once, under a key of the log's content, the device and the sources of the diagnosis. An
interrupted run therefore continues where it stopped, and outdated results are not reused. If a worker dies, dask gives
its log to another one. A log that cannot be diagnosed becomes a row with the reason.

<results>/reports/<log>-<key>.json   the GapReport of a log
<results>/rows/<key>.json            its Row; written last, so that every row has its report
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from hashlib import file_digest, sha256
from pathlib import Path

import via_core
import via_sim
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker
from distributed.security import Security
from via_core.devices import Device
from via_core.errors import ViaError
from via_core.text_files import replace_text
from via_sim.effects import place_name
from via_sim.effects.own import loaded

import via_gap
from via_gap.report.report import GapReport, read_report
from via_gap.run.worker import Failed, Finished, Job, diagnosed, undisturbed

OnDone = Callable[[int, int, Path | None], None]  # number of logs done, of all logs, and the log just done
PATIENCE = "20s"  # for a scheduler to answer
SHOWN = 12  # characters of a key in file names


@dataclass(frozen=True)
class Row:
    """One log of a fleet. Numbers are None and texts empty where there is no report."""

    log: str  # path as given
    key: str
    reason: str = ""  # why there is no report, in one line
    verdict: str = ""
    where: str = ""  # site with the largest share
    share: float | None = None  # [-] of that site
    causes: str = ""  # named effects with their sites
    probability: float | None = None  # [-] of the first cause
    parameters: str = ""  # of the first cause
    before: float | None = None  # [-] gap of the device as filed
    after: float | None = None  # [-] with its parameters fitted and the effects added
    floor: float | None = None  # [-] of sensor noise alone
    explained: float | None = None  # [-] fraction of the error that can be explained
    seconds: float | None = None  # [s] duration of the diagnosis
    report: str = ""  # its file, relative to the results


@dataclass(frozen=True)
class Workers:
    """Processes of a fleet."""

    scheduler: str | None = None  # address of dask's, whose workers have VIA and the same files; None: on this machine
    count: int | None = None  # number of processes on this machine; None: one per core


def run_fleet(
    logs: Sequence[Path],
    device: Device,
    results: Path,
    progress: OnDone = lambda _done, _of, _path: None,
    workers: Workers = Workers(),
) -> list[Row]:
    """Diagnose every log; rows in the order of `logs`.

    progress  called with the number of logs done, first with those of earlier runs

    Raises ViaError where the results cannot be written or the scheduler does not answer.
    """
    try:
        for folder in ("rows", "reports"):
            (results / folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ViaError(f"{results}: cannot be written: {error.strerror}") from None
    found: dict[str, Row] = {}
    keys = []
    for path in logs:
        try:
            key = key_of(path, device)
            row = found.get(key) or _earlier(results, key)
        except OSError as error:
            key = f"unreadable: {path}"
            row = Row(str(path), key, str(error.strerror))
        keys.append(key)
        found |= {key: row} if row is not None else {}
    todo = {key: path for key, path in zip(keys, logs, strict=True) if key not in found}
    every = len(found) + len(todo)
    progress(len(found), every, None)
    if todo:
        with _client(workers) as client:
            for key, row in _diagnosed(client, todo, device, results):
                found[key] = row
                progress(len(found), every, todo[key])
    return [replace(found[key], log=str(path)) for key, path in zip(keys, logs, strict=True)]


def _diagnosed(client: Client, todo: dict[str, Path], device: Device, results: Path) -> Iterator[tuple[str, Row]]:
    text = device.model_dump_json()
    futures = {
        client.submit(_timed, str(path.resolve()), text, loaded(), key=f"via-gap-{key}"): key
        for key, path in todo.items()
    }
    try:
        for future in as_completed(list(futures), loop=client.loop):
            key = futures.pop(future)
            path = todo[key]
            try:
                outcome, seconds = future.result()
            except KilledWorker:
                row = Row(str(path), key, "every process that diagnosed it died")
            except Exception as error:  # an error in the diagnosis itself; not stored, so that the next run tries again
                row = Row(str(path), key, f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")
            else:
                row = _kept(results, Row(str(path), key, seconds=round(seconds, 3)), outcome)
            yield key, row
    finally:
        client.cancel(list(futures))


def _timed(path: str, device: str, own_effects: tuple[str, ...]) -> tuple[Finished | Failed, float]:
    """The task of a process: the outcome for the log at `path` against `device` (JSON), and how long it took [s]."""
    begin = time.perf_counter()
    outcome = diagnosed(Job(Device.model_validate_json(device), Path(path), own_effects=own_effects))
    return outcome, time.perf_counter() - begin


def _kept(results: Path, row: Row, outcome: Finished | Failed) -> Row:
    """The row with an outcome; it and its report are written."""
    if isinstance(outcome, Failed):
        row = replace(row, reason=outcome.reason.removeprefix(f"{Path(row.log).resolve()}: "))
    else:
        name = f"reports/{Path(row.log).stem}-{row.key[:SHOWN]}.json"
        replace_text(results / name, outcome.report)
        found = row_of(read_report(outcome.report, name), row.log, row.key)
        row = replace(found, seconds=row.seconds, report=name)
    replace_text(results / "rows" / f"{row.key}.json", json.dumps(asdict(row), indent=1) + "\n")
    return row


def row_of(report: GapReport, log: str, key: str) -> Row:
    """The report in one line."""
    cause = report.causes[0] if report.causes and report.verdict != "no_gap" else None
    values = {} if cause is None else cause.parameters
    return Row(
        log=log,
        key=key,
        verdict=report.verdict,
        where=place_name(report.where[0].site, report.where[0].motor) if report.where else "",
        share=report.where[0].share if report.where else None,
        causes=", ".join(f"{each.effect} at {place_name(each.site, each.motor)}" for each in report.effects),
        probability=None if cause is None else cause.probability,
        parameters=", ".join(f"{name} {v.value:.4g} +- {v.sd:.1g} {v.unit}" for name, v in values.items()),
        before=getattr(report.gap, "before", None),
        after=getattr(report.gap, "after", None),
        floor=getattr(report.gap, "floor", None),
        explained=getattr(report.gap, "explained", None),
    )


# ---- keys


def key_of(log: Path, device: Device) -> str:
    """Hash of a log's content, its device, own effects, and the sources of the diagnosis.

    Raises OSError for an unreadable log.
    """
    digest = sha256()
    for part in (engine(), device.model_dump_json(), *loaded()):
        digest.update(part.encode() + b"\0")
    for file in filter(Path.is_file, map(Path, loaded())):
        digest.update(file.read_bytes())
    # The name is part of the report, and its ending decides how the file is read.
    digest.update(log.name.encode(errors="surrogateescape") + b"\0")
    files = sorted(each for each in log.rglob("*") if each.is_file()) if log.is_dir() else [log]
    for file in files:
        digest.update(str(file.relative_to(log.parent)).encode(errors="surrogateescape") + b"\0")
        with file.open("rb") as content:
            digest.update(file_digest(content, "sha256").digest())
    return digest.hexdigest()


@cache
def engine() -> str:
    """SHA-256 of every source file that a report depends on."""
    digest = sha256()
    for package in (via_core, via_sim, via_gap):
        folder = Path(str(package.__file__)).parent
        for file in sorted(each for each in folder.rglob("*") if each.suffix in (".py", ".yaml")):
            digest.update(str(file.relative_to(folder)).encode() + file.read_bytes())
    return digest.hexdigest()


# ---- files


def _earlier(results: Path, key: str) -> Row | None:
    """The row of an earlier run, if it and its report exist and are complete."""
    try:
        row = Row(**json.loads((results / "rows" / f"{key}.json").read_text(encoding="utf-8")))
        if row.report:
            read_report((results / row.report).read_text(encoding="utf-8"), row.report)
    except (OSError, ValueError, TypeError, ViaError):
        return None
    return row


# ---- dask


@contextmanager
def _client(workers: Workers) -> Iterator[Client]:
    """A client of the scheduler, or of local processes that only this one can command: TLS with keys of this run."""
    with ExitStack() as stack:
        if workers.scheduler is not None:
            try:
                client = Client(workers.scheduler, timeout=PATIENCE, set_as_default=False)
            except (OSError, ValueError, TypeError) as error:
                reason = " ".join(str(error).split()) or "does not answer"
                raise ViaError(f"scheduler {workers.scheduler}: {reason}") from None
        else:
            temporary = tempfile.TemporaryDirectory(prefix="via_fleet_", ignore_cleanup_errors=True)
            folder = stack.enter_context(temporary)
            count = workers.count or len(os.sched_getaffinity(0))
            with undisturbed():
                cluster = LocalCluster(
                    n_workers=count, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
                    local_directory=folder, silence_logs=logging.CRITICAL, security=Security.temporary(),
                )  # fmt: skip
            client = Client(stack.enter_context(cluster), set_as_default=False)
        stack.enter_context(client)
        yield client
