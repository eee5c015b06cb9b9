"""Option of the commands for effects that another package or file defines."""

from __future__ import annotations

from typing import Annotated

import typer


def _load(context: typer.Context, names: list[str] | None) -> list[str]:
    from via_sim.effects.own import load_own

    for name in () if context.resilient_parsing else names or ():  # completion executes nothing
        load_own(name)
    return names or []


# Loaded before the other options are used, so that files of effects may name them.
OwnEffects = Annotated[
    list[str] | None,
    typer.Option(
        "--own-effects",
        help="Python module or file that adds effects to the catalogue; its code is executed. Repeat for several.",
        callback=_load,
        is_eager=True,
    ),
]
