"""`via gap blind export`: do repairs that are exported to MuJoCo have the gap that their reports state?"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from via_bringup.cli.console import answers, table

from via_validation.commands.gap_blind import Cases, app, progress

__all__ = ["app"]


@app.command("export")
def check_exports(
    cases: Cases,
    results: Annotated[Path, typer.Option(help="Folder of the reports.")],
    as_file: Annotated[Path | None, typer.Option("--json", help="Write every number to this file.")] = None,
) -> None:
    """Export the repair of every report to MuJoCo and compare the gap there; exit code 1 if one differs by 2 points."""
    from via_validation.exported import exported_cases  # MuJoCo takes a second to load
    from via_validation.sealed.sealing import names_in

    found = []
    with progress(sum((results / f"{name}.json").exists() for name in names_in(cases))) as bar:
        for each in exported_cases(cases, results):
            found.append(each)
            bar.advance(bar.task_ids[0])
    listing = table(
        f"{len(found)} cases: gap after the repair [%]", "case", "effects", "report", "via_sim", "MuJoCo", ""
    )
    listing.columns[1].justify = "left"
    for each in found:
        stated = "-" if each.report is None else f"{100.0 * each.report:.3f}"
        word = f"lost: {', '.join(each.lost)}" if each.lost else "ok" if each.kept else "MISSED"
        row = (each.name, ", ".join(each.effects), stated, f"{100.0 * each.via_sim:.3f}", f"{100.0 * each.mujoco:.3f}")
        listing.add_row(*row, word)
    answers.print(listing)
    slotted = [abs(each.difference) for each in found if not each.lost]
    if slotted:
        answers.print(f"largest difference with slots for all effects: {100.0 * max(slotted):.3f} points")
    if as_file is not None:
        content = [asdict(each) for each in found]
        as_file.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if not all(each.kept for each in found):
        raise typer.Exit(1)
