"""`via gap diagnose`, `render` and `simulate`: the gap between logs and the model of their device."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.recordings.entries import Constants
from via_gap.design.proposal import with_proposal
from via_gap.diagnosis import diagnose as diagnosed
from via_gap.logs.log import read_logs
from via_gap.rendering.page import write_page
from via_gap.rendering.text import text
from via_gap.report.report import save_repair
from via_gap.report.withheld import before_and_after
from via_sim.effects.files import load_effects

from via_bringup.cli.console import answers, working
from via_bringup.cli.gap_arm import Arm, CountsPerTurn, TorqueConstant, diagnosed_arm, joint_of_arm, named_causes
from via_bringup.cli.options import OwnEffects, saved_report
from via_bringup.cli.outputs import check_files, save


def diagnose(
    logs: Annotated[
        list[Path], typer.Argument(help="Bags, CSV, Parquet, NumPy, MATLAB or JSON files of one joint, or of an arm.")
    ],
    device: Annotated[str | None, typer.Option(help="Device name (see `via devices`) or path to its YAML.")] = None,
    arm: Arm = None,
    holdout: Annotated[
        list[Path] | None, typer.Option(help="Log held out for scoring; default: blocks of LOGS.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the report to this file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the report as one HTML page to this file.")] = None,
    effects_out: Annotated[
        Path | None, typer.Option(help="Write the effects and refitted device parameters to this effects file.")
    ] = None,
    counts_per_turn: CountsPerTurn = None,
    torque_constant: TorqueConstant = None,
    own_effects: OwnEffects = None,
) -> None:
    """Locate the gap between logs and model, identify its causes, and report the fraction that they explain.

    For an arm, one report per joint is written: report.json becomes report_JOINT.json. What all joints feel
    is written to report_payload.json, report_body.json, report_offset.json or report_gravity.json, with the
    name of its joint appended if there are several of a kind.
    """
    if (device is None) == (arm is None):
        raise ViaError("give either --device or --arm")
    check_files(out, html, effects_out)
    with working("reading and diagnosing") as progress:
        found = None
        if arm is not None:
            found = diagnosed_arm(arm, logs, holdout or (), Constants(counts_per_turn, torque_constant), progress)
            reports = found.reports
        else:
            described = load_device(device or "")
            everything = read_logs([*logs, *(holdout or ())], described)
            read, held = everything[: len(logs)], everything[len(logs) :]
            report = diagnosed(read, described, held or None, progress)
            progress("searching for a motion that separates tied causes", 1.0)
            reports = (with_proposal(report, described),)
    for name, cause in named_causes(found):
        answers.print(f"{cause.text()}\n", soft_wrap=True)
        if out is not None:
            save(_named(out, name), json.dumps(asdict(cause), indent=2) + "\n")
            answers.print("")
    for number, report in enumerate(reports):
        answers.print("\n" * (number > 0) + text(report), soft_wrap=True)
        joint = report.joint if arm is not None else ""
        if out is not None:
            save(_named(out, joint), report.to_json())
        if html is not None:
            write_page(report, _named(html, joint))
            answers.print(f"wrote {_named(html, joint)}")
        if effects_out is not None:
            save_repair(report, _named(effects_out, joint))
            answers.print(f"wrote {_named(effects_out, joint)}")
        if out is not None and device is not None and report.repaired():
            answers.print(f"next: via export {out} --device {device} --to mjcf --check {logs[0]}", soft_wrap=True)


def _named(path: Path, joint: str) -> Path:
    """The path with the name of an arm's joint appended; unchanged if `joint` is empty."""
    return path.with_stem(f"{path.stem}_{joint}") if joint else path


def render(
    report: Annotated[Path, typer.Argument(help="Report written by `via gap diagnose --json`.")],
    html: Annotated[Path | None, typer.Option(help="Write the report as one HTML page to this file.")] = None,
    own_effects: OwnEffects = None,
) -> None:
    """Print a saved report as text; optionally write it as an HTML page."""
    check_files(html)
    saved = saved_report(report)
    answers.print(text(saved), soft_wrap=True)
    if html is not None:
        write_page(saved, html)
        answers.print(f"wrote {html}")


def simulate(
    logs: Annotated[list[Path], typer.Argument(help="Bags, CSV, Parquet, NumPy, MATLAB or JSON files.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML; of an --arm, the name of its joint.")],
    effects: Annotated[Path | None, typer.Option(help="Effects file to add to the nominal model.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Report of these logs: use its repair unless --effects is given, score its held-out data."),
    ] = None,
    arm: Arm = None,
    payload: Annotated[
        list[Path] | None,
        typer.Option(help="report_payload.json, _body, _offset or _gravity of `via gap diagnose --arm`; repeatable."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--json", help="Write the numbers to this file.")] = None,
    counts_per_turn: CountsPerTurn = None,
    torque_constant: TorqueConstant = None,
    own_effects: OwnEffects = None,
) -> None:
    """Simulate logs without and with effects and print both errors against the measurement.

    For a joint of an --arm the error is the residual torque of its equation of motion; nothing is simulated.
    """
    check_files(out)
    saved = saved_report(report) if report is not None else None
    added = load_effects(effects) if effects is not None else saved.repaired() if saved is not None else ()
    held_out = saved.held_out if saved is not None else ()
    if arm is not None:
        described, read = joint_of_arm(arm, device, logs, payload or (), Constants(counts_per_turn, torque_constant))
    else:
        described = load_device(device)
        read = read_logs(logs, described)
    by_equations = arm is not None or (saved is not None and saved.by_equations)
    if saved is not None:
        read = saved.as_read(read)
    with working(f"simulating {len(read)} logs without and with effects"):
        before, after = before_and_after(read, described, added, held_out, by_equations)
    floor = float(np.sqrt(np.mean(before.floors**2)))
    answers.print(f"gap: {before.overall:.4g} before, {after.overall:.4g} after, floor {floor:.3g}")
    if out is not None:
        signals = {
            name: {"before": float(a), "after": float(b)}
            for name, a, b in zip(before.names, before.signals, after.signals, strict=True)
        }
        content = {"before": before.overall, "after": after.overall, "floor": floor, "signals": signals}
        save(out, json.dumps(content, indent=2) + "\n")
