"""`via layout`: files for Foxglove and PlotJuggler."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import load_device
from via_core.text_files import write_text

from via_bringup import dashboards
from via_bringup.cli.console import answers
from via_bringup.cli.outputs import check_files


def layout(
    device: Annotated[str, typer.Argument(help="Device name or path to its YAML.")],
    to: Annotated[str, typer.Option(help=f"Program: {', '.join(dashboards.FORMATS)}.")] = "foxglove",
    out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None,
) -> None:
    """Write a layout for Foxglove or PlotJuggler that shows samples, commands, estimates and gap of a joint."""
    check_files(out)
    text = dashboards.layout(load_device(device), to)
    if out is None:
        print(text, end="")
        return
    write_text(out, text)
    answers.print(f"layout for {to} written to {out}")
