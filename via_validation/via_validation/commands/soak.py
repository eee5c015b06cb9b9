"""`via soak`: endurance of the live graph."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import errors

from via_validation.commands.row_table import Json, shown

PAGE = "soak-live.md"


def soak(
    seconds: Annotated[float, typer.Option(min=4.0, max=1e6, help="Duration \\[s].")] = 1800.0,
    rate: Annotated[float, typer.Option(min=1.0, max=1000.0, help="Rate of the simulator \\[Hz].")] = 1000.0,
    as_rows: Json = None,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} into this folder.")] = None,
) -> None:
    """Run the live graph at 1 kHz and check that no message is lost and no memory grows (30 minutes).

    Simulator, controller, estimator and recorder are separate processes. The exit code is 1 if a limit is missed.
    """
    from via_validation.provenance import provenance
    from via_validation.reliability import endurance, endurance_page  # load nodes

    source = provenance(f"via soak --seconds {seconds:g} --rate {rate:g}")
    columns = TextColumn("soak: {task.completed:.0f} of {task.total:.0f} s"), TimeElapsedColumn()
    with tempfile.TemporaryDirectory(prefix="via_soak_") as folder:
        with Progress(*columns, console=errors, transient=True) as bar:
            task = bar.add_task("", total=seconds)
            run = endurance.run(Path(folder), seconds, rate, lambda passed: bar.update(task, completed=passed))
        rows = endurance.rows(run)
    if write is not None:
        endurance_page.write(run, rows, source, write / PAGE)
    shown("endurance of the live graph", rows, as_rows)
    if any(row.ok is False for row in rows):
        raise typer.Exit(1)
