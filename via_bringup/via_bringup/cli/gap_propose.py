"""`via gap propose`: the short motion that would separate the causes a log left undecided, as a file of commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import load_device
from via_core.errors import ViaError
from via_gap.design.commands import RANGE
from via_gap.design.motion_file import write_motion
from via_gap.design.proposal import propose
from via_gap.report.report import read_report

from via_bringup.cli.console import answers


def propose_motion(
    report: Annotated[Path, typer.Argument(help="Report of `via gap diagnose --json`.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML; else the report's joint.")] = "",
    out: Annotated[Path | None, typer.Option(help="Commands: a .csv file, or else a new bag folder.")] = None,
    reach: Annotated[float, typer.Option(min=0.01, max=6.0, help="Largest motor angle from rest \\[rad].")] = RANGE,
) -> None:
    """Propose the motion that best distinguishes tied causes, within the device's limits."""
    try:
        text = report.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ViaError(f"{report}: cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}") from None
    told = read_report(text, str(report))
    described = load_device(device or told.joint)
    found = propose(told, described, reach)
    if found is None:
        answers.print("nothing to decide: the report names one answer")
        return
    answers.print(found.text)
    if out is not None:
        write_motion(out, described, found.commands)
        answers.print(f"wrote {out}")
        completed = told.model_copy(update={"proposal": found.summary(described.name, str(out))})
        report.write_text(completed.to_json(), encoding="utf-8")
