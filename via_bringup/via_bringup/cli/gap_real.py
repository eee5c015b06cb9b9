"""`via gap real`: what the diagnosis says of two real robots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from via_core.errors import ViaError

from via_bringup.cli.console import answers, errors

DATA = Path("shared") / "data"  # beside the repo


def real(
    data: Annotated[
        Path | None, typer.Option(help="Folder with maccepavd/ and dfki_double_pendulum/; else beside the repo.")
    ] = None,
    write: Annotated[Path | None, typer.Option(help="Write gap-real.md and its pictures into this folder.")] = None,
) -> None:
    """Diagnose the MACCEPA-VD and the DFKI double pendulum from their public recordings."""
    folder = data or Path.cwd().parent / DATA
    missing = [name for name in ("maccepavd", "dfki_double_pendulum") if not (folder / name).is_dir()]
    if missing:
        if data is not None:
            raise ViaError(f"no folder {missing[0]} in {data}")
        answers.print("skipped: the recordings are not beside the repo; name their folder with --data")
        return
    from via_bringup.gap_real import page  # loads matplotlib and pinocchio
    from via_bringup.gap_real.run import diagnose_both, diagnose_joint
    from via_bringup.provenance import provenance

    columns = (SpinnerColumn(), TextColumn("{task.percentage:3.0f} % {task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        arm = diagnose_both(
            folder / "dfki_double_pendulum",
            lambda what, share: bar.update(task, description=what, completed=0.4 * share),
        )
        joint = diagnose_joint(
            folder / "maccepavd", lambda what, share: bar.update(task, description=what, completed=0.4 + 0.6 * share)
        )
    answers.print(f"maccepavd: NRMSE of held-out runs {joint.before:.3f} -> {joint.after:.3f}")
    answers.print(page.verdict(joint.report).replace("*", ""), soft_wrap=True)
    for each in arm:
        answers.print(f"{each.device.name}: {page.verdict(each.within).replace('*', '')}", soft_wrap=True)
    if write is not None:
        answers.print(f"wrote {page.write(joint, arm, provenance('via gap real --write docs/results'), write)}")
