"""`via gap`: what separates a log from its device's model, and the log simulated with effects."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from via_core.devices import Device, load_device
from via_core.errors import ViaError
from via_gap.design.proposal import with_proposal
from via_gap.diagnose import diagnose as diagnosed
from via_gap.logs.log import JointLog, read_logs
from via_gap.rendering.page import write_page
from via_gap.rendering.text import text
from via_gap.report.report import GapReport, read_report, save_repair
from via_gap.report.withheld import before_and_after
from via_sim.effects_file import load_effects

from via_bringup.cli.console import answers, errors

Arm = Annotated[
    str | None, typer.Option(help="Arm of rigid joints, by name or path to its YAML: logs hold all of its joints.")
]


def diagnose(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files of one joint, or of an arm.")],
    device: Annotated[str | None, typer.Option(help="Device name (see `via devices`) or path to its YAML.")] = None,
    arm: Arm = None,
    holdout: Annotated[list[Path] | None, typer.Option(help="Log to judge on instead of blocks of the others.")] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the report to this file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the report as one HTML page to this file.")] = None,
    effects_out: Annotated[
        Path | None, typer.Option(help="Write the named effects, and the numbers fitted with them, for the simulator.")
    ] = None,
) -> None:
    """Report where the gap between logs and model lies, which effect causes it and how far it shrinks.

    For an arm, one report and one set of files per joint is written: report.json becomes report_JOINT.json.
    """
    if (device is None) == (arm is None):
        raise ViaError("name either a --device or an --arm")
    columns = (SpinnerColumn(), TextColumn("{task.percentage:3.0f} % {task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)

        def tell(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        if arm is not None:
            reports = _of_arm(arm, logs, holdout or (), tell)
        else:
            described = load_device(device or "")
            everything = read_logs([*logs, *(holdout or ())], described)
            read, held = everything[: len(logs)], everything[len(logs) :]
            report = diagnosed(read, described, held or None, tell)
            tell("looking for a motion that decides", 1.0)
            reports = (with_proposal(report, described),)
    for number, report in enumerate(reports):
        answers.print("\n" * (number > 0) + text(report), soft_wrap=True)
        of = report.joint if arm is not None else ""
        if out is not None:
            _write(_named(out, of), report.to_json())
        if html is not None:
            write_page(report, _named(html, of))
        if effects_out is not None:
            save_repair(report, _named(effects_out, of))
        for path in (out, html, effects_out):
            if path is not None:
                answers.print(f"wrote {_named(path, of)}")


def _of_arm(
    arm: str, logs: list[Path], holdout: Sequence[Path], tell: Callable[[str, float], None]
) -> tuple[GapReport, ...]:
    from via_gap.run.arms import diagnose_arm, load_arm, read_arm_log  # pinocchio takes a second to load

    whole = load_arm(arm)
    read, held = ([read_arm_log(path, whole) for path in paths] for paths in (logs, holdout))
    return diagnose_arm(whole, read, held, tell)


def _named(path: Path, joint: str) -> Path:
    """The file of one joint of an arm; of a single joint the path itself."""
    return path.with_stem(f"{path.stem}_{joint}") if joint else path


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


def simulate(
    logs: Annotated[list[Path], typer.Argument(help="Bag folders, .mcap or .csv files.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML.")],
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Report of these logs: only what it held out counts; its repair, without a file."),
    ] = None,
    arm: Arm = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the numbers to this file.")] = None,
) -> None:
    """Simulate logs without and with effects and print the error of each against the measurement.

    A joint of an --arm is not simulated: its error is the torque that its equation of motion lacks.
    """
    described = load_device(device)
    told = read_report(_text(report), str(report)) if report is not None else None
    added = load_effects(effects) if effects is not None else told.repaired() if told is not None else ()
    held_out = told.held_out if told is not None else ()
    if arm is not None:
        read = _joint_of_arm(arm, described, logs)
    else:
        read = read_logs(logs, described)
    by_equations = arm is not None or (told is not None and told.by_equations)
    if told is not None:
        read = told.as_read(read)
    before, after = before_and_after(read, described, added, held_out, by_equations)
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


def _joint_of_arm(arm: str, device: Device, logs: list[Path]) -> list[JointLog]:
    from via_gap.run.arms import load_arm, read_arm_log

    whole = load_arm(arm)
    names = [each.name for each in whole.devices]
    if device.name not in names:
        raise ViaError(f"'{device.name}' is no joint of '{whole.name}', whose are {', '.join(names)}")
    return [read_arm_log(path, whole)[names.index(device.name)] for path in logs]


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
