"""`via fuzz`: damaged files, given to the public loaders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track
from via_bringup.cli.console import answers, errors, print_table

PAGE = "fuzz.md"


def fuzz(
    inputs: Annotated[int, typer.Option(help="Damaged files of each kind.")] = 1000,
    kind: Annotated[list[str] | None, typer.Option(help="Kind of file (repeat for more); default: all.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the damage.")] = 0,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} into this folder, after every kind.")] = None,
) -> None:
    """Damage files and give them to the loaders: each must be read or refused in one line.

    The exit code is 1 if one is not.
    """
    from via_validation.fuzz import page  # loads the diagnosis
    from via_validation.fuzz.inputs import kinds
    from via_validation.fuzz.run import Result, batches
    from via_validation.provenance import provenance

    names = kind or list(kinds())
    words = f"via fuzz --inputs {inputs}" + "".join(f" --kind '{name}'" for name in kind or []) + f" --seed {seed}"
    source, found = provenance(words), dict[str, Result]()
    for name in track(names, "damaged files", console=errors):
        found[name] = sum(batches(name, inputs, seed), Result())
        if write is not None:
            page.write(found, names[len(found) :], seed, source, write / PAGE)
    rows = (
        (name, *map(str, (each.files, each.read, each.refused, len(each.faults))), f"{each.growth:.1f}")
        for name, each in found.items()
    )
    print_table("damaged files", ("kind", "files", "read", "refused", "faults", "memory growth [MB]"), rows)
    for fault in (fault for each in found.values() for fault in each.faults):
        answers.print(fault, markup=False)
    if any(each.faults for each in found.values()):
        raise typer.Exit(1)
