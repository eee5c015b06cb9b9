"""`via gap exports`: do repairs that are exported to MuJoCo have the gap that their reports state?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_core.errors import ViaError
from via_core.text_files import write_text

from via_validation.commands.gap_real import DATA

if TYPE_CHECKING:
    from via_validation.exports.exported import Exported
    from via_validation.exports.sources import Source

FILES = "files"


def exports(
    cases: Annotated[Path | None, typer.Option(help="Folder of sealed cases.")] = None,
    results: Annotated[Path | None, typer.Option(help="Folder of the reports of these cases.")] = None,
    keys: Annotated[
        Path | None, typer.Option(help="Folder of the keys of these cases; only their seeds are read, for the page.")
    ] = None,
    real: Annotated[Path, typer.Option(help="Folder of the results of `via gap real`.")] = Path("out/gap-real"),
    data: Annotated[
        Path | None, typer.Option(help="Folder of the recordings; default: shared/data beside the repository.")
    ] = None,
    kept: Annotated[
        Path, typer.Option(help="Folder for the exported files and results; an interrupted run continues from there.")
    ] = Path("out/exports"),
    as_file: Annotated[Path | None, typer.Option("--json", help="Write every number to this file.")] = None,
    write: Annotated[Path | None, typer.Option(help="Write export.md into this folder.")] = None,
) -> None:
    """Export repairs of sealed cases and real robots to MuJoCo, URDF and SDF, and compare the gap in MuJoCo.

    Exit code 1 if a gap differs by 2 points and the list of losses does not explain it, or a reader complains about a
    file.
    """
    if (cases is None) != (results is None):
        raise ViaError("give --cases and --results together")
    from via_validation.exports.exported import exported, keep  # MuJoCo takes a second to load
    from via_validation.exports.exported import kept as stored
    from via_validation.exports.reading import read_all

    made: list[Exported] = []
    sources = _sources(cases, results, real, data)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("", total=len(sources))
        for source in sources:
            bar.update(task, description=source.name)
            found = stored(source, kept)
            if found is None:
                found = exported(source, kept / FILES)
                keep(found, kept)
            made.append(found)
            bar.advance(task)
    readers = read_all(kept / FILES)
    _show(made)
    complaints = {reader: sum(map(len, files.values())) for reader, files in readers.items()}
    for reader, count in complaints.items():
        answers.print(f"{reader}: {len(readers[reader])} files, {count} complaints")
    if as_file is not None:
        content = [each.model_dump() for each in made]
        write_text(as_file, json.dumps(content, indent=1, allow_nan=False) + "\n")
    if write is not None:
        from via_validation.exports.page import write as write_page
        from via_validation.exports.sources import seeds_of
        from via_validation.provenance import provenance

        names = [each.name for each in made if each.group == "sealed"]
        seeds = seeds_of(names, keys) if keys is not None and names else None
        origin = str(provenance("via gap exports --write docs/results"))
        answers.print(f"wrote {write_page(made, readers, seeds, origin, write)}")
    if not all(each.kept for each in made) or any(complaints.values()):
        raise typer.Exit(1)


def _sources(cases: Path | None, results: Path | None, real: Path, data: Path | None) -> list[Source]:
    """The reports to export; real robots are skipped where recordings or results are missing."""
    from via_validation.exports.sources import real_sources, sealed_sources

    found = [] if cases is None or results is None else sealed_sources(cases, results)
    folder = data or Path.cwd().parent / DATA
    robots = real_sources(real, folder) if folder.is_dir() else []
    if not robots:
        answers.print(f"real robots skipped: no recordings in {folder}, or no results of `via gap real` in {real}")
    if not found and not robots:
        raise ViaError("nothing to export: give --cases and --results, or run `via gap real` first")
    return [*found, *robots]


def _show(made: list[Exported]) -> None:
    """Print the summary, and the cases that differ."""
    from via_validation.exports.page import percent, points, summaries

    columns = (
        "cases", "all", "slots", "same gap", "largest [points]", "least share", "lost", "as listed", "rest [points]",
        "failed",
    )  # fmt: skip
    rows = (
        (each.name, str(each.all), str(each.slotted), str(each.within), points(each.difference),
         percent(each.reproduced), str(each.lossy), str(each.explained), points(each.rest), str(each.failed))
        for each in summaries(made)
    )  # fmt: skip
    print_table("Exported repairs", columns, rows)
    for case in made:
        if not case.kept:
            answers.print(f"{case.name}: {case.failure or 'differs'}", soft_wrap=True)
