"""`via bag map`: what the columns or topics of a recording may hold, and a mapping file for them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from via_core.devices import load_device
from via_core.errors import SignalError
from via_core.recordings.entries import Constants
from via_core.recordings.guess import ColumnGuess, guess_columns, guess_time
from via_core.recordings.mapping_text import mapping_text
from via_core.recordings.tables import is_bag, numbers, read_tables
from via_core.recordings.unnamed import require_names

from via_bringup.cli.console import answers, errors, table
from via_bringup.cli.options import CountsPerTurn, TorqueConstant
from via_bringup.cli.outputs import check_new, save

if TYPE_CHECKING:
    from pandas import DataFrame


def map_file(
    file: Annotated[
        Path, typer.Argument(help="Bag (.mcap, .db3 or folder), CSV, Parquet, NumPy, MATLAB or JSON file.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Write the commented mapping for `via bag import` to this file.")
    ] = None,
    device: Annotated[
        str, typer.Option(help="Device of the joint, name or path to its YAML: its commands are mapped, too.")
    ] = "",
    joint: Annotated[str, typer.Option(help="Name of the joint, where columns name none.")] = "",
    joints: Annotated[
        str, typer.Option(help="Names of all joints, base first, comma-separated: for numbered columns.")
    ] = "",
    counts_per_turn: CountsPerTurn = None,
    torque_constant: TorqueConstant = None,
) -> None:
    """Show columns or topics of a recording with rates and guesses, and write the commented mapping."""
    bag, tables = is_bag(file), read_tables(file)
    if device:
        load_device(device)
    names = [name.strip() for name in joints.split(",") if name.strip()]
    guesses = guess_columns(tables, names, bag=bag)
    for name, frame in tables.items():
        time = guess_time(frame, bag)
        shown = f"{name or file.name}: {len(frame)} rows"
        if time is not None:
            shown += f", {time.rate:.4g} Hz; time is '{time.column}' in {time.unit} ({time.reason})"
        columns = ("column", "quantity", "joint", "unit", "lowest", "highest", "because")
        listing = table(shown, *columns, texts=("quantity", "joint", "unit", "because"))
        for each in (guess for guess in guesses if guess.table == name):
            ends = _range(frame, each.column)
            listing.add_row(each.column, each.quantity or "-", each.joint, each.unit, *ends, each.reason)
        answers.print(listing)
    require_names(file, tables)
    seen = list(dict.fromkeys(guess.joint for guess in guesses if guess.quantity == "position"))
    if bag and "/joint_states" not in tables:
        answers.print(
            "a bag needs no mapping; without /joint_states, `via device new` writes the topics to wire.columns"
        )
    elif bag:
        answers.print("a bag needs no mapping: a device file finds its joint by name, for example")
        for name in seen[:3]:
            answers.print(f"  wire: {{link: {name}, motors: [{name}]}}")
    elif out is not None:
        main = _main(guesses)
        time = guess_time(tables[main[0].table]) if main else None
        if time is None:
            raise SignalError(f"{file}: no column increases like a time; add one")
        check_new(out)
        save(out, mapping_text(file, time, main, Constants(counts_per_turn, torque_constant), device, joint))
        errors.print("check units and signs in it")
        answers.print(f"next: via bag import {file.parent} --mapping {out} --out BAGS", soft_wrap=True)
    else:
        answers.print("add --out MAPPING.yaml to write the mapping for `via bag import`")
    chosen = f" --joint {joint or seen[0]}" if joint or (seen and seen[0]) else ""
    answers.print(f"for a device file: via device new MODEL.urdf{chosen} --log {file}", soft_wrap=True)


def _main(guesses: list[ColumnGuess]) -> list[ColumnGuess]:
    """The guesses of the table with the first position."""
    first = next((guess.table for guess in guesses if guess.quantity == "position"), "")
    return [guess for guess in guesses if guess.table == first]


def _range(frame: DataFrame, column: str) -> tuple[str, str]:
    try:
        values = numbers(frame, column)
    except SignalError:
        return "text", "text"
    there = values[np.isfinite(values)]
    return (f"{there.min():.4g}", f"{there.max():.4g}") if len(there) else ("empty", "empty")
