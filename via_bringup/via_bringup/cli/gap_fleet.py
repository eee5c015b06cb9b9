"""`via gap fleet`: diagnose many logs in parallel and list the results in one table."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from via_core.devices import load_device
from via_core.text_files import write_text

from via_bringup.cli.console import answers, errors, print_table
from via_bringup.cli.options import OwnEffects
from via_bringup.cli.outputs import check_files, check_folder

if TYPE_CHECKING:
    from via_gap.run.fleet import Row

HEADER = ("log", "verdict", "where", "causes", "probability", "gap before", "after", "explained")


def fleet(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files of joints of one type.")],
    device: Annotated[str, typer.Option(help="Device name (see `via devices`) or path to its YAML.")],
    results: Annotated[Path, typer.Option(help="Folder for reports and table; a later run resumes from it.")],
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask scheduler, e.g. tcp://host:8786; default: this machine.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes on this machine; default: one per core.")
    ] = None,
    markdown: Annotated[Path | None, typer.Option(help="Also write the table to this Markdown file.")] = None,
    own_effects: OwnEffects = None,
) -> None:
    """Diagnose many logs and print one table; also written to fleet.csv and fleet.json in the results folder."""
    from via_gap.run.fleet import Workers, run_fleet  # importing dask takes a second

    check_folder(results)
    check_files(markdown)
    described = load_device(device)
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("starting", total=len(logs))

        def progress(done: int, total: int, path: Path | None) -> None:
            if path is not None:
                step = path.name
            else:
                step = f"{done} already done" if done else "starting"
            bar.update(task, completed=done, total=total, description=step)

        rows = run_fleet(logs, described, results, progress, Workers(scheduler, workers))
    print_table(f"{len(rows)} logs", HEADER, map(cells, rows))
    write_text(results / "fleet.csv", as_csv(rows))
    write_text(results / "fleet.json", json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    written = [results / "fleet.csv", results / "fleet.json"]
    if markdown is not None:
        write_text(markdown, as_markdown(rows))
        written.append(markdown)
    answers.print(f"wrote {', '.join(map(str, written))}", soft_wrap=True)
    failed = sum(not row.verdict for row in rows)
    if failed:
        errors.print(f"{failed} of {len(rows)} logs have no report")
    if failed == len(rows):
        raise typer.Exit(2)


def cells(row: Row) -> tuple[str, ...]:
    """Texts of a row, one per column of HEADER."""
    share = "" if row.share is None else f" {100.0 * row.share:.0f} %"
    percent = ["" if value is None else f"{100.0 * value:.0f} %" for value in (row.probability, row.explained)]
    gaps = ["" if value is None else f"{value:.4g}" for value in (row.before, row.after)]
    return (row.log, row.verdict or "-", row.where + share, row.reason or row.causes, percent[0], *gaps, percent[1])


def as_csv(rows: Sequence[Row]) -> str:
    """All fields of all rows as CSV, with a header."""
    from via_gap.run.fleet import Row

    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([each.name for each in fields(Row)])
    writer.writerows(astuple(row) for row in rows)  # None becomes an empty cell
    return out.getvalue()


def as_markdown(rows: Sequence[Row]) -> str:
    """The table in Markdown."""
    lines = [HEADER, tuple("---" for _ in HEADER), *(cells(row) for row in rows)]
    return "".join(f"| {' | '.join(each.replace('|', chr(92) + '|') for each in line)} |\n" for line in lines)
