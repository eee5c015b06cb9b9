"""`via tables`: every table and quoted number of the document, compared with ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors
from via_core.errors import ViaError

from via_validation.commands.row_table import STDOUT, Json, print_rows, save_json
from via_validation.provenance import provenance
from via_validation.tables.page import Report, as_json, write_html, write_markdown
from via_validation.tables.run import SECTIONS, chosen, run_sections

TITLES = ("id", "case", "quantity", "document", "ours", "limit", "verdict")
PAGES = " and ".join(dict.fromkeys(f"{each.page}.md" for each in SECTIONS))


def tables(
    section: Annotated[
        list[str] | None,
        typer.Option(help=f"Only this section of {', '.join(s.name for s in SECTIONS)} (repeat for more)."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=10_000, help="Noise realisations per noisy row.")] = 50,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of real MACCEPA-VD runs; default: the data set or the sample."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for index.html and the pictures.")] = Path("out/tables"),
    as_rows: Json = None,
    write: Annotated[
        Path | None, typer.Option(help=f"Also write {PAGES} with small pictures into this folder.")
    ] = None,
) -> None:
    """Reproduce the tables and figures of the document: its numbers, ours, and the limits."""
    sections = chosen(section or [])
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ViaError(f"{out} cannot be made: {error.strerror}; choose another folder with --out") from None
    columns = (
        TextColumn("{task.description:<10}"),
        BarColumn(),
        TextColumn("{task.fields[what]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=errors) as bars:
        tasks = {each.name: bars.add_task(f"section {each.name}"[-10:], total=None, what="") for each in sections}

        def progress(name: str, done: int, of: int, what: str) -> None:
            bars.update(tasks[name], completed=done, total=of, what=what)

        finished, interrupted = run_sections(sections, seeds, out, progress, data)

    words = ["via tables", *(f"--section {name}" for name in section or []), f"--seeds {seeds}"]
    words += [f"--data {data}"] * (data is not None)
    report = Report(finished, seeds, provenance(" ".join(words)))
    write_html(report, out / "index.html")
    if write is not None:
        write_markdown(report, write)
    if as_rows != STDOUT:
        for each in filter(lambda each: each.rows, finished):
            print_rows(f"{each.section.name}: {each.section.title}", each.rows, TITLES, TITLES[3:-1])
        _conclude(report, out)
    save_json(as_json(report.rows), as_rows)
    for each in finished:
        if each.trouble:
            errors.print(f"section {each.section.name}: {each.trouble}")
    if interrupted:
        raise typer.Exit(130)
    if any(each.trouble for each in finished):
        raise typer.Exit(1)


def _conclude(report: Report, out: Path) -> None:
    missed = ", ".join(row.id for row in report.missed)
    answers.print(
        f"{len(report.rows)} rows, {report.limited} with a limit, {len(report.missed)} missed"
        + (f": {missed}" if missed else "")
        + f"; page with pictures: {out / 'index.html'}"
    )
