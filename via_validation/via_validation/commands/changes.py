"""`via changes`: how the estimators follow springs and dampers that change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_core.devices import load_device

PAGE, PICTURE = "change.md", "change.png"


def changes(
    device: Annotated[
        list[str] | None,
        typer.Option(help="Joint with two springs and motor torques, or with a damper (repeat for more)."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Noise realisations per schedule, at most.")] = 5,
    budget: Annotated[
        float, typer.Option(min=0.0, help="Processor time of a method per schedule \\[s]; slow ones have fewer seeds.")
    ] = 10.0,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} and its picture into this folder.")] = None,
) -> None:
    """Report bias, random error, fastest change followed and coverage of every estimator on joints that change."""
    from via_validation.changes import page  # loads matplotlib, every estimator and the simulator
    from via_validation.changes.experiment import DEVICES
    from via_validation.changes.run import Effort, follow
    from via_validation.provenance import provenance

    chosen = [load_device(name) for name in device or DEVICES]
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=errors) as bars:
        task = bars.add_task("", total=None)

        def progress(done: int, of: int, what: str) -> None:
            bars.update(task, completed=done, total=of, description=f"{what:<40}")

        found, defaults = follow(chosen, Effort(seeds, budget), progress)
    for name, own in page.devices_of(found).items():
        print_table(f"{name}: {own[0].output}", page.SUMMARY, page.summary_rows(own, defaults[name]))
    limits = page.limits_of(found, defaults)
    missed = [words for words, kept in limits if not kept]
    answers.print(
        f"{len(limits)} limits of the defaults, {len(missed)} missed" + "".join(f"\n  {each}" for each in missed)
    )
    if write is not None:
        words = [
            "via changes",
            *(f"--device {name}" for name in device or []),
            f"--seeds {seeds}",
            f"--budget {budget:g}",
        ]
        page.draw(found, write / PICTURE)
        page.write(found, defaults, provenance(" ".join(words)), PICTURE, write / PAGE)
        answers.print(f"page: {write / PAGE}")
