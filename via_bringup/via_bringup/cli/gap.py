"""`via gap`: what separates a log from its device's model, and the log simulated with effects."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from via_core.devices import load_device
from via_core.errors import ViaError
from via_gap.diagnose import diagnose as diagnosed
from via_gap.log import read_log
from via_gap.proposal import with_proposal
from via_gap.rendering.page import write_page
from via_gap.rendering.text import text
from via_gap.report import read_report, save_repair
from via_gap.withheld import before_and_after
from via_sim.effects_file import load_effects

from via_bringup.cli import gap_blind, gap_fleet, gap_propose, gap_real
from via_bringup.cli.console import answers, errors

app = typer.Typer(help="Diagnose the gap between a log and its model.", no_args_is_help=True)
app.add_typer(gap_blind.app, name="blind")
app.command("propose")(gap_propose.command)
app.command("fleet")(gap_fleet.fleet)
app.command("real")(gap_real.real)


@app.command("diagnose")
def diagnose(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files of one joint.")],
    device: Annotated[str, typer.Option(help="Device name (see `via devices`) or path to its YAML.")],
    holdout: Annotated[list[Path] | None, typer.Option(help="Log to judge on instead of blocks of the others.")] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the report to this file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the report as one HTML page to this file.")] = None,
    effects_out: Annotated[
        Path | None, typer.Option(help="Write the named effects, and the numbers fitted with them, for the simulator.")
    ] = None,
) -> None:
    """Say where the gap between logs and model lies, which effect causes it and how far it shrinks."""
    described = load_device(device)
    read = [read_log(path, described) for path in logs]
    held = [read_log(path, described) for path in holdout or ()]
    columns = (SpinnerColumn(), TextColumn("{task.percentage:3.0f} % {task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        report = diagnosed(
            read, described, held or None, lambda what, share: bar.update(task, description=what, completed=share)
        )
        bar.update(task, description="looking for a motion that decides")
        report = with_proposal(report, described)
    answers.print(text(report), soft_wrap=True)
    if out is not None:
        _write(out, report.to_json())
        answers.print(f"wrote {out}")
    if html is not None:
        write_page(report, html)
        answers.print(f"wrote {html}")
    if effects_out is not None:
        save_repair(report, effects_out)
        answers.print(f"wrote {effects_out}")


@app.command("render")
def render(
    report: Annotated[Path, typer.Argument(help="Report that `via gap diagnose --json` wrote.")],
    html: Annotated[Path | None, typer.Option(help="Write it as one HTML page to this file.")] = None,
) -> None:
    """Show a report again: as text, and as a page."""
    told = read_report(_text(report), str(report))
    answers.print(text(told), soft_wrap=True)
    if html is not None:
        write_page(told, html)
        answers.print(f"wrote {html}")


@app.command("simulate")
def simulate(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML.")],
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Report of these logs: only what it held out counts; its repair, without a file."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the numbers to this file.")] = None,
) -> None:
    """Simulate logs without and with effects and print how far each is from what was measured."""
    described = load_device(device)
    told = read_report(_text(report), str(report)) if report is not None else None
    added = load_effects(effects) if effects is not None else told.repaired() if told is not None else ()
    read = [read_log(path, described) for path in logs]
    before, after = before_and_after(read, described, added, told.held_out if told is not None else ())
    floor = float(np.sqrt(np.mean(before.floors**2)))
    answers.print(f"gap: {before.overall:.4g} before, {after.overall:.4g} after, floor {floor:.3g}")
    if out is not None:
        signals = {
            name: {"before": float(a), "after": float(b)}
            for name, a, b in zip(before.names, before.signals, after.signals, strict=True)
        }
        content = {"before": before.overall, "after": after.overall, "floor": floor, "signals": signals}
        _write(out, json.dumps(content, indent=2) + "\n")
        answers.print(f"wrote {out}")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ViaError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}") from None


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
