"""`via fuzz`: damaged files, given to the public loaders."""

from __future__ import annotations

from typing import Annotated

import typer
from via_bringup.cli.console import answers, table


def fuzz(
    inputs: Annotated[int, typer.Option(help="Damaged files of each kind.")] = 1000,
    kind: Annotated[list[str] | None, typer.Option(help="Kind of file (repeat for more); default: all.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the damage.")] = 0,
) -> None:
    """Damage files and give them to the loaders: each must be read or refused in one line.

    The exit code is 1 if one is not.
    """
    from via_validation.fuzz.inputs import kinds
    from via_validation.fuzz.run import batches

    listing, faults = table("damaged files", "kind", "read", "refused", "faults", "memory growth per batch [MB]"), []
    for name in kind or kinds():
        found = list(batches(name, inputs, seed))
        own = [fault for each in found for fault in each.faults]
        faults += own
        growth = max(each.growth for each in found)
        counts = sum(each.read for each in found), sum(each.refused for each in found), len(own)
        listing.add_row(name, *map(str, counts), f"{growth:.1f}")
    answers.print(listing)
    for fault in faults:
        answers.print(fault)
    if faults:
        raise typer.Exit(1)
