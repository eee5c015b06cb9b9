"""Run the sections of the document, each in a separate process, two at a time.

A section is a module of this package with `rows(seeds, progress)` and `pictures(folder, progress)`. If one fails or is
interrupted, the results of the others are kept.
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

Progress = Callable[[str, int, int, str], None]  # section, done, of how many, description
# Trouble of a section whose process ends without a message after it has sent this.
LEFT = {"start": "its process ended early", "rows": "its process ended before the pictures were drawn"}


@dataclass(frozen=True)
class Section:
    """A section of the document and the module that reproduces it."""

    name: str
    title: str
    module: str
    page: str = "estimation"  # name of the page in the repository
    recordings: bool = False  # whether its functions take the folder of recordings as a third argument


@dataclass(frozen=True)
class Finished:
    """Results of a section; `trouble` states why they are incomplete, empty if they are complete."""

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
    Section("servo", "Servos, payload and friction that are not those of the file", "via_validation.tables.servo"),
    Section("6", "Cyclic motions of arms with flexible joints", "via_validation.tables.section6", "control"),
    Section("errors", "Controllers of arms under model errors", "via_validation.tables.model_errors", "control"),
    Section("7", "The fastest link of a visco-elastic joint", "via_validation.tables.section7", "control"),
)


def chosen(names: Sequence[str], there: Sequence[Section] = SECTIONS) -> tuple[Section, ...]:
    """The sections of these names, all for an empty list. Raises ParameterError for an unknown name."""
    known = {section.name: section for section in there}
    for name in names:
        if name not in known:
            raise ParameterError(f"no section '{name}'; there are: {', '.join(known)}")
    return tuple(known[name] for name in names or known)


def run_sections(
    sections: Sequence[Section], seeds: int, folder: Path, progress: Progress, data: Path | None = None
) -> tuple[tuple[Finished, ...], bool]:
    """Results of all sections, in the given order, and whether an interrupt ended the run early.

    seeds   noise realisations per row
    folder  for the pictures, which are written to `folder`/<section>/
    data    folder of a real robot's recordings, for sections that need one; None: their default
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
    """Body of the process: rows first, then pictures."""

    def progress(done: int, of: int, what: str) -> None:
        send(("progress", (done, of, what)))

    part = "rows"
    try:
        section: Any = import_module(module)
        send(("rows", tuple(section.rows(seeds, progress, *more))))
        part = "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        send(("pictures", tuple(section.pictures(folder, progress, *more))))
    except Exception as error:  # any error ends this section only and is reported
        send(("trouble", f"{part}: {type(error).__name__}: {error}"))
