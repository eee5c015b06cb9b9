"""The sections of the document, each in a process of its own, two at a time: rows and pictures, or why there are none.

A section is a module of this package with `rows(seeds, progress)` and `pictures(folder, progress)`. One that fails or
is interrupted costs itself: what others have finished stays.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from via_core.errors import ParameterError

from via_validation.side_by_side import Send, side_by_side
from via_validation.tables.rows import Row

Progress = Callable[[str, int, int, str], None]  # section, done, of how many, what
# What is wrong with a section whose process ends in silence after having sent this.
LEFT = {"start": "its process ended early", "rows": "its process ended before the pictures were there"}


@dataclass(frozen=True)
class Section:
    """A section of the document and the module that reproduces it."""

    name: str
    title: str
    module: str
    page: str = "estimation"  # of the repository, on which its rows stand
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
    Section("3", "Stiffness from modulating functions", "via_validation.tables.section3"),
    Section("4", "Stiffness from signals, without derivatives", "via_validation.tables.section4"),
    Section("5", "Variable physical damping", "via_validation.tables.section5"),
    Section("robot", "A real robot: the MACCEPA-VD", "via_validation.tables.robot", recordings=True),
    Section("6", "Cyclic motions of arms with flexible joints", "via_validation.tables.section6", "control"),
    Section("7", "The fastest link of a visco-elastic joint", "via_validation.tables.section7", "control"),
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
    done: dict[int, Finished] = {}
    since: dict[int, float] = {}

    def started(number: int) -> None:
        since[number] = time.monotonic()
        done[number] = Finished(sections[number], trouble=LEFT["start"])

    def receive(number: int, sent: tuple[str, Any]) -> None:
        kind, content = sent
        if kind == "progress":
            progress(sections[number].name, *content)
        else:
            done[number] = replace(done[number], **{"trouble": LEFT.get(kind, ""), kind: content})

    def ended(number: int) -> None:
        done[number] = replace(done[number], seconds=time.monotonic() - since[number])

    jobs = [(_work, (s.module, seeds, folder / s.name, (data,) if s.recordings else ())) for s in sections]
    complete = side_by_side(jobs, receive, started, ended)
    if not complete:
        for number, section in enumerate(sections):
            found = done.get(number, Finished(section))
            if number not in done or found.trouble in LEFT.values():
                done[number] = replace(found, trouble="interrupted")
    return tuple(done[number] for number in range(len(sections))), not complete


def _work(module: str, seeds: int, folder: Path, more: tuple[Path | None, ...], send: Send) -> None:
    """In the process: rows first, which are what counts, then pictures."""

    def progress(done: int, of: int, what: str) -> None:
        send(("progress", (done, of, what)))

    part = "rows"
    try:
        section: Any = import_module(module)
        send(("rows", tuple(section.rows(seeds, progress, *more))))
        part = "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        send(("pictures", tuple(section.pictures(folder, progress, *more))))
    except Exception as error:  # whatever it is, it is this section's own, and said
        send(("trouble", f"{part}: {type(error).__name__}: {error}"))
