"""Rows of a benchmark on the terminal and as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text
from via_bringup.cli.console import answers, table

from via_validation.tables.page import as_json, number, verdict
from via_validation.tables.rows import Row

Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this file; -: only to stdout.")]
STYLES = {"ok": "green", "MISSED": "bold red"}


def shown(title: str, rows: list[Row], as_rows: Path | None) -> None:
    """Print the rows as a table; `as_rows`: write them as JSON too, or only to stdout for '-'."""
    objects = json.dumps(as_json(rows), indent=1, allow_nan=False) + "\n"
    if as_rows == Path("-"):
        print(objects, end="")
        return
    listing = table(title, "id", "what", "quantity", "measured", "limit", "verdict")
    listing.columns[1].justify = listing.columns[2].justify = "left"
    for row in rows:
        word = verdict(row)
        what = Text.assemble(row.what, (f"\n{row.remark}", "dim") if row.remark else "")
        listing.add_row(
            row.id, what, row.quantity, number(row.ours), number(row.limit), Text(word, STYLES.get(word, ""))
        )
    answers.print(listing)
    if as_rows is not None:
        as_rows.write_text(objects, encoding="utf-8")
