"""`via bench arm` and `joints`: an arm in real time, and what its diagnosis costs per joint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track
from via_bringup.cli.console import answers, errors
from via_core.text_files import write_text

from via_validation.commands.row_table import Json, shown


def arm(
    seconds: Annotated[float, typer.Option(min=5.0, max=3600.0, help="Duration for each controller \\[s].")] = 20.0,
    as_rows: Json = None,
) -> None:
    """Controllers of an arm over DDS in real time at 1 kHz in one process: late commands and their effect."""
    from via_validation.bench.arm import arm_rows

    shown("Arm in real time", arm_rows(seconds), as_rows)


def joints(
    seconds: Annotated[float, typer.Option(min=6.0, max=600.0, help="Duration of the recordings \\[s].")] = 60.0,
    write: Annotated[Path | None, typer.Option(help="Write arm-cost.md into this folder.")] = None,
) -> None:
    """Diagnosis of arms of 1, 2, 4 and 7 joints from one recording each: processor time per joint."""
    from via_validation.bench.joints import COUNTS, PAGE, costs, page  # pinocchio takes a second to load
    from via_validation.provenance import provenance

    found = list(track(costs(COUNTS, seconds), "arms", len(COUNTS), console=errors))
    for each in found:
        answers.print(f"{each.joints} joints: {each.processor:.1f} s of processor time, {each.each:.2f} s per joint")
    if write is not None:
        source = provenance(f"via bench joints --seconds {seconds:g} --write docs/results")
        write_text(write / PAGE, page(found, source, seconds))
        answers.print(f"wrote {write / PAGE}")
