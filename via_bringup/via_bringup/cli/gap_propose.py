"""`via gap propose`: a short motion that separates tied causes, or tests the model, as a file of commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_core.devices import load_device
from via_core.text_files import write_text
from via_gap.design.commands import RANGE, angles_under
from via_gap.design.motion_file import write_motion
from via_gap.design.proposal import general_motion, propose
from via_sim.plants import JointPlant

from via_bringup.cli.console import answers, working
from via_bringup.cli.options import OwnEffects, saved_report
from via_bringup.cli.outputs import check_files


def propose_motion(
    report: Annotated[
        Path, typer.Argument(help="Report written by `via gap diagnose --json`; --out adds the proposal to it.")
    ],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML; default: the report's joint.")] = "",
    out: Annotated[Path | None, typer.Option(help="Write the commands to this .csv file or new bag folder.")] = None,
    reach: Annotated[float, typer.Option(min=0.01, max=6.0, help="Largest motor angle from rest \\[rad].")] = RANGE,
    own_effects: OwnEffects = None,
) -> None:
    """Propose the motion that best separates the tied causes of a report, within the device's limits.

    Without tied causes, the motion written by --out has many speeds: its log tests the model once more.
    """
    check_files(out)
    saved = saved_report(report)
    described = load_device(device or saved.joint)
    with working("searching for a motion that separates tied causes"):
        found = propose(saved, described, reach)
    if found is None:
        answers.print("nothing to decide: the report has no tied causes that a motion within the limits separates")
        if out is not None:
            motion, commands = general_motion(described, reach)
            write_motion(out, described, commands, angles_under(JointPlant.from_device(described), commands))
            answers.print(f"wrote {out}: '{motion.name}', which tests the model at many speeds")
        return
    answers.print(found.text)
    if out is not None:
        write_motion(out, described, found.commands, found.reference)
        answers.print(f"wrote {out}")
        completed = saved.model_copy(update={"proposal": found.summary(described.name, str(out))})
        write_text(report, completed.to_json())
