"""`via export`: a device with the effects of a report, for another simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import Device, load_device
from via_core.errors import ViaError
from via_export import FORMATS, Export, add_arm_cause
from via_export import check as checked
from via_export import export as exported
from via_export.mjcf_given import note_on_place
from via_gap.logs.log import read_logs
from via_gap.report.report import GapReport, LogInterval
from via_gap.run.arm_cause import is_cause, read_cause
from via_sim.effects import Effect
from via_sim.effects.files import load_effects

from via_bringup.cli.console import answers, print_table
from via_bringup.cli.options import OwnEffects, saved_report
from via_bringup.cli.outputs import save_or_print


def export(
    source: Annotated[
        Path,
        typer.Argument(
            help="Report of `via gap diagnose --json`, of a joint or an arm (report_payload.json ...), or effects file."
        ),
    ],
    device: Annotated[
        str, typer.Option(help="Device name or path to its YAML: the nominal model. Not for report_payload.json.")
    ] = "",
    to: Annotated[str, typer.Option(help=f"Format: {', '.join(FORMATS)}.")] = "mjcf",
    into: Annotated[
        Path | None, typer.Option(help="File of that format to write the joint into; it is not overwritten.")
    ] = None,
    joint: Annotated[str, typer.Option(help="Name of the joint in --into; default: that of the device.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None,
    supply: Annotated[float | None, typer.Option(help="Supply voltage of the drive \\[V], for bam.")] = None,
    check: Annotated[
        list[Path] | None, typer.Option(help="Log to simulate with the exported model in MuJoCo itself (mjcf).")
    ] = None,
    own_effects: OwnEffects = None,
) -> None:
    """Write a device with the effects of a report for another simulator, and list what that cannot hold.

    Without --into a model of the joint alone is written. --check states the gap of the log before and after the repair
    in MuJoCo, beside that of the simulator of the diagnosis and of the report. What all joints of an arm feel (a
    payload, a body, an offset, gravity) is written into the robot in --into.
    """
    if check and to != "mjcf":
        raise ViaError(f"--check runs MuJoCo: it needs --to mjcf, got '{to}'")
    if source.suffix.lower() == ".json" and is_cause(source):
        _add_cause(source, to, into, out, bool(check))
        return
    if not device:
        raise ViaError("--device is missing: the name of a device or the path of its YAML")
    described = load_device(device)
    effects, report = _read(source)
    made = exported(described, effects, to, into, joint, supply)
    _write(made, out)
    for loss in made.losses:
        answers.print(f"lost: {loss}", soft_wrap=True)
    moved = note_on_place(out) if made.format == "mjcf" and into is not None and out is not None else []
    for note in (*made.notes, *moved):
        answers.print(f"note: {note}", soft_wrap=True)
    if check:
        _check(check, described, effects, report, into, joint)


def _add_cause(source: Path, to: str, into: Path | None, out: Path | None, check: bool) -> None:
    """Write what all joints of an arm feel into a robot."""
    if into is None:
        raise ViaError("what all joints of an arm feel belongs into its robot: add --into ROBOT, its URDF or MJCF file")
    if check:
        raise ViaError("--check compares a joint: use it with a report of a joint, report_JOINT.json")
    text = add_arm_cause(read_cause(source), to, into, f"With {source.name}; written by via export.")
    save_or_print(out, text)


def _read(source: Path) -> tuple[tuple[Effect, ...], GapReport | None]:
    """Effects of a report, or of an effects file."""
    if source.suffix.lower() == ".json":
        report = saved_report(source)
        return report.repaired(), report
    return load_effects(source), None


def _write(made: Export, out: Path | None) -> None:
    save_or_print(out, made.text)
    if made.parameters:
        save_or_print(None if out is None else out.with_suffix(".yaml"), made.parameters)


def _check(
    paths: list[Path],
    device: Device,
    effects: tuple[Effect, ...],
    report: GapReport | None,
    into: Path | None,
    joint: str,
) -> None:
    logs = read_logs(paths, device)
    held_out: tuple[LogInterval, ...] = ()
    if report is not None:
        logs = report.as_read(logs)
        names = {each.log for each in report.held_out}
        held_out = report.held_out if names & {log.name for log in logs} else ()
    found = checked(logs, device, effects, into, joint, held_out)
    pairs = {"MuJoCo": found.mujoco, "via_sim": found.via_sim}
    gaps = {name: (before.overall, after.overall) for name, (before, after) in pairs.items()}
    if report is not None and report.gap is not None:
        gaps[f"report ({report.gap.by})"] = report.gap.before, report.gap.after
    cells = ((name, *(f"{100.0 * gap:.3g} %" for gap in pair)) for name, pair in gaps.items())
    title = "Gap: error over the standard deviation of the measurement"
    print_table(title, ("simulator", "before", "after"), cells)
    part = "the intervals that the report held out" if held_out else "the whole logs"
    answers.print(f"on {part}; sensor noise alone: {100.0 * found.floor:.3g} %", soft_wrap=True)
    if report is not None and report.by_equations:
        answers.print("The report compares equations, this check simulates segments: compare the first two lines.")
