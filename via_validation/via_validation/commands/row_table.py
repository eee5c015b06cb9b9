"""Rows of benchmarks and tables on the terminal and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text
from via_bringup.cli.console import print_table

from via_validation.tables.page import as_json, number, verdict
from via_validation.tables.rows import Row

Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this file; -: only to stdout.")]
STYLES = {"ok": "green", "MISSED": "bold red"}
STDOUT = Path("-")  # as a file of JSON: printed, and nothing else


def shown(title: str, rows: list[Row], as_rows: Path | None) -> None:
    """Print the rows as a table; `as_rows`: write them as JSON too, or only to stdout for '-'."""
    if as_rows != STDOUT:
        print_rows(title, rows, ("id", "what", "quantity", "measured", "limit", "verdict"), ("ours", "limit"))
    save_json(as_json(rows), as_rows)


def print_rows(title: str, rows: Sequence[Row], columns: Sequence[str], numbers: Sequence[str]) -> None:
    """Print id, case, quantity, these numbers and the verdict of rows."""
    cells = (
        (
            row.id,
            Text.assemble(row.what, (f"\n{row.remark}", "dim") if row.remark else ""),
            row.quantity,
            *(number(getattr(row, name)) for name in numbers),
            coloured(verdict(row)),
        )
        for row in rows
    )
    print_table(title, columns, cells, texts=columns[1:3])


def coloured(word: str) -> Text:
    """A verdict in its colour."""
    return Text(word, STYLES.get(word, ""))


def save_json(content: Any, file: Path | None) -> None:
    """Write plain data to a file, or print it for STDOUT; None: neither."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    if file == STDOUT:
        print(text, end="")
    elif file is not None:
        file.write_text(text, encoding="utf-8")
