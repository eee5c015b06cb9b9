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
from via_gap.report import Cause, GapReport, read_report
from via_gap.withheld import before_and_after
from via_sim.effects_file import load_effects, save_effects

from via_bringup.cli import gap_blind
from via_bringup.cli.console import answers, errors, table

app = typer.Typer(help="Diagnose the gap between a log and its model.", no_args_is_help=True)
app.add_typer(gap_blind.app, name="blind")
SAID = {
    "effect": "one effect explains the gap",
    "two_effects": "two effects together explain the gap",
    "no_gap": "no gap: the model explains the log within its tolerance and the sensors' noise",
    "unknown": "none of the known effects explains the gap",
    "cannot_tell": "this log cannot tell",
}


@app.command("diagnose")
def diagnose(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files of one joint.")],
    device: Annotated[str, typer.Option(help="Device name (see `via devices`) or path to its YAML.")],
    holdout: Annotated[list[Path] | None, typer.Option(help="Log to judge on instead of blocks of the others.")] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the report to this file.")] = None,
    effects_out: Annotated[Path | None, typer.Option(help="Write the named effects for the simulator.")] = None,
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
    _print(report)
    if out is not None:
        _write(out, report.to_json())
        answers.print(f"wrote {out}")
    if effects_out is not None:
        save_effects(effects_out, report.repair())
        answers.print(f"wrote {effects_out}")


@app.command("simulate")
def simulate(
    log: Annotated[Path, typer.Argument(help="Bag folder, .mcap or .csv file.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML.")],
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    report: Annotated[Path | None, typer.Option(help="Report whose fitted device numbers to use as well.")] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the numbers to this file.")] = None,
) -> None:
    """Simulate a log without and with effects and print how far each is from what was measured."""
    described = load_device(device)
    added = load_effects(effects) if effects is not None else ()
    told = read_report(_text(report), str(report)) if report is not None else None
    before, after = before_and_after(read_log(log, described), described, added, told)
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


def _print(report: GapReport) -> None:
    answers.print(f"{report.joint}: {SAID[report.verdict]}")
    for finding in report.data_check:
        errors.print(f"{finding.severity}: {finding.log}: {finding.text}")
    for said in report.not_judged:
        errors.print(f"note: {said}")
    if report.where:
        places = ", ".join(f"{w.site}{f' {w.motor}' if w.motor else ''} {100 * w.share:.0f} %" for w in report.where)
        answers.print(f"where: {places}")
    if report.causes:
        shown = table("", "effect", "place", "probability", "left", "parameters")
        for cause in report.causes:
            place = f"{cause.site}{f' {cause.motor}' if cause.motor else ''}"
            shown.add_row(cause.effect, place, f"{cause.probability:.3f}", f"{100 * cause.left:.2g} %", _values(cause))
        answers.print(shown)
    if len(report.equivalence_set) > 1:
        tied = ", ".join(f"{each.effect} at {each.site} {each.motor or ''}".strip() for each in report.equivalence_set)
        answers.print(f"not told apart by this log: {tied}")
    if report.gap is not None:
        gap = report.gap
        answers.print(
            f"gap by {gap.by}: {gap.before:.4g} before, {gap.tuned:.4g} with the device's numbers tuned, "
            f"{gap.after:.4g} after ({gap.interval[0]:.4g} to {gap.interval[1]:.4g}); closes {100 * gap.closes:.0f} % "
            f"of what can be closed (floor {gap.floor:.3g})"
        )


def _values(cause: Cause) -> str:
    return ", ".join(f"{name} {v.value:.4g} +- {v.sd:.1g} {v.unit}" for name, v in cause.parameters.items())


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ViaError(f"cannot write {path}: {error.strerror}") from None
