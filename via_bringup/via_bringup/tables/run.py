"""The sections of the document, each in a process of its own, two at a time: rows and pictures, or why there are none.

A section is a module of this package with `rows(seeds, progress)` and `pictures(folder, progress)`. One that fails or
is interrupted costs itself: what others have finished stays.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, cast

from via_core.errors import ParameterError

from via_bringup.tables.rows import Row

AT_ONCE = 2
Progress = Callable[[str, int, int, str], None]  # section, done, of how many, what
# What is wrong with a section whose process ends in silence after having sent this.
LEFT = {"start": "its process ended early", "rows": "its process ended before the pictures were there"}


@dataclass(frozen=True)
class Section:
    """A part of the document and the module that reproduces it."""

    name: str
    title: str
    module: str
    recordings: bool = False  # whether its functions take the folder of recordings as a third argument


@dataclass(frozen=True)
class Finished:
    """What came of a section; `trouble` says why there is less than there should be, empty when all went well."""

    section: Section
    rows: tuple[Row, ...] = ()
    pictures: tuple[Path, ...] = ()
    seconds: float = 0.0
    trouble: str = ""


SECTIONS = (
    Section("3", "Stiffness from modulating functions", "via_bringup.tables.section3"),
    Section("4", "Stiffness from signals, without derivatives", "via_bringup.tables.section4"),
    Section("5", "Variable physical damping", "via_bringup.tables.section5"),
    Section("robot", "A real robot: the MACCEPA-VD", "via_bringup.tables.robot", recordings=True),
)


def chosen(names: Sequence[str], there: Sequence[Section] = SECTIONS) -> tuple[Section, ...]:
    """The sections of these names, all where there are none; raises ParameterError for a stranger."""
    known = {section.name: section for section in there}
    for name in names:
        if name not in known:
            raise ParameterError(f"no section '{name}'; there are: {', '.join(known)}")
    return tuple(known[name] for name in names or known)


def run_sections(
    sections: Sequence[Section], seeds: int, folder: Path, progress: Progress, data: Path | None = None
) -> tuple[tuple[Finished, ...], bool]:
    """Every section's results, in the order given, and whether an interrupt ended it before all were there.

    seeds   noise realisations per row
    folder  for the pictures, which go to `folder`/<section>/
    data    folder of a real robot's recordings, for sections that take one; None: what they find
    """
    waiting = list(sections)
    done: dict[str, Finished] = {}
    running: dict[Connection, tuple[Finished, SpawnProcess, float]] = {}
    interrupted = False
    try:
        while waiting or running:
            while waiting and len(running) < AT_ONCE:
                section = waiting.pop(0)
                reader, process = _start(section, seeds, folder / section.name, data)
                running[reader] = Finished(section, trouble=LEFT["start"]), process, time.monotonic()
            for ready in wait(list(running)):
                reader = cast(Connection, ready)
                found, process, since = running[reader]
                try:
                    kind, content = reader.recv()
                except EOFError:
                    process.join()
                    del running[reader]
                    done[found.section.name] = replace(found, seconds=time.monotonic() - since)
                    continue
                if kind == "progress":
                    progress(found.section.name, *content)
                else:
                    running[reader] = replace(found, **{"trouble": LEFT.get(kind, ""), kind: content}), process, since
    except KeyboardInterrupt:
        interrupted = True
        for found, process, since in running.values():
            process.terminate()
            process.join()
            done[found.section.name] = replace(found, trouble="interrupted", seconds=time.monotonic() - since)
    return tuple(done.get(s.name, Finished(s, trouble="interrupted")) for s in sections), interrupted


def _start(section: Section, seeds: int, folder: Path, data: Path | None) -> tuple[Connection, SpawnProcess]:
    """A process that works on a section and sends (kind, content) until it ends."""
    context = get_context("spawn")  # a fork would copy the threads of the progress display
    reader, writer = context.Pipe(duplex=False)
    more = (data,) if section.recordings else ()
    process = context.Process(target=_work, args=(section.module, seeds, folder, more, writer), daemon=True)
    process.start()
    writer.close()
    return reader, process


def _work(module: str, seeds: int, folder: Path, more: tuple[Path | None, ...], writer: Connection) -> None:
    """In the process: rows first, which are what counts, then pictures."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it

    def progress(done: int, of: int, what: str) -> None:
        writer.send(("progress", (done, of, what)))

    part = "rows"
    try:
        section: Any = import_module(module)
        writer.send(("rows", tuple(section.rows(seeds, progress, *more))))
        part = "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        writer.send(("pictures", tuple(section.pictures(folder, progress, *more))))
    except Exception as error:  # whatever it is, it is this section's own, and said
        writer.send(("trouble", f"{part}: {type(error).__name__}: {error}"))
