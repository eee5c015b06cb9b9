"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from via_core.text_files import read_text

if TYPE_CHECKING:
    from via_gap.report.report import GapReport


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
DeviceName = Annotated[str, typer.Argument(help="Device name (see `via devices`) or path to its YAML.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write the results to this JSON file.")]
CountsPerTurn = Annotated[float | None, typer.Option(min=1.0, help="Counts of one turn, for positions in counts.")]
TorqueConstant = Annotated[
    float | None,
    typer.Option(help="Torque per current at the joint \\[N m/A]: constant of the motor times gear ratio."),
]


def saved_report(path: Path) -> GapReport:
    """The report in a file of `via gap diagnose --json`. Raises ViaError in one line."""
    from via_gap.report.report import read_report

    return read_report(read_text(path), str(path))
