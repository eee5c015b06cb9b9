"""`via bench ...`: speed beside others' in the same run. What it loads is heavy, so each command loads its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from via_bringup.cli.console import answers, errors, table
from via_bringup.tables.page import as_json, number, verdict
from via_bringup.tables.rows import Row

app = typer.Typer(help="Measure speed, memory and endurance beside other libraries'.", no_args_is_help=True)

Json = Annotated[
    Path | None, typer.Option("--json", help="Write the rows to this file; -: to stdout, and nothing else.")
]
Turns = Annotated[int, typer.Option(min=1, max=1000, help="Alternating repeats, of which the median counts.")]
STYLES = {"ok": "green", "MISSED": "bold red"}


@app.command()
def core() -> None:
    """Reading bags by column beside mcap-ros2-support and rosbags."""
    from via_bringup.bench import bags

    bags.main()


@app.command()
def sim() -> None:
    """The simulator beside MuJoCo and scipy at equal accuracy."""
    from via_bringup.bench import simulator

    simulator.main()


@app.command()
def estimators(turns: Turns = 15, as_rows: Json = None) -> None:
    """Estimators beside C++ with Eigen, padasip and numpy; full steps, memory, growth."""
    from via_bringup.bench.estimators import estimator_rows

    shown("Estimators", estimator_rows(turns, errors.print), as_rows)


@app.command("all")
def everything(turns: Turns = 15) -> None:
    """All of them, one after the other."""
    core()
    sim()
    estimators(turns)


def shown(title: str, rows: list[Row], as_rows: Path | None) -> None:
    """Rows as a table, and as JSON where asked for."""
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
