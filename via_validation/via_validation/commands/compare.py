"""`via compare`: all stiffness estimators on the same joints, motion and noise."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, table
from via_core.devices import load_device
from via_core.errors import ViaError

PAGE = "comparison.md"


def compare(
    device: Annotated[
        list[str] | None,
        typer.Option(help="Antagonistic joint with torque drive (repeat for more); default: three qbmoves."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Noise realisations per case, at most.")] = 20,
    budget: Annotated[
        float, typer.Option(min=0.0, help="Processor time of a method per case \\[s]; slow methods have fewer seeds.")
    ] = 20.0,
    out: Annotated[Path, typer.Option(help="Folder for the picture.")] = Path("out/compare"),
    as_numbers: Annotated[
        Path | None, typer.Option("--json", help="Write all results to this file; -: only to stdout.")
    ] = None,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} and its picture into this folder.")] = None,
) -> None:
    """Compare accuracy, convergence, coverage, robustness and cost of all stiffness estimators."""
    from via_validation.compare import page, picture  # load matplotlib and every estimator
    from via_validation.compare.experiment import DEVICES
    from via_validation.compare.run import Effort
    from via_validation.compare.run import compare as run_comparison
    from via_validation.provenance import provenance

    chosen = [load_device(name) for name in device or DEVICES]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ViaError(f"{out} cannot be made: {error.strerror}; choose another folder with --out") from None
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=errors) as bars:
        task = bars.add_task("", total=None)

        def progress(done: int, of: int, what: str) -> None:
            bars.update(task, completed=done, total=of, description=f"{what:<52}")

        done = run_comparison(chosen, Effort(seeds, budget), progress)

    drawn = out / "comparison.png"
    picture.draw(done, drawn)
    words = ["via compare", *(f"--device {name}" for name in device or []), f"--seeds {seeds}", f"--budget {budget:g}"]
    source = provenance(" ".join(words))
    if write is not None:
        page.write_markdown(done, drawn, source, write / PAGE)
    objects = json.dumps(page.as_json(done, source), indent=1, allow_nan=False) + "\n"
    if as_numbers == Path("-"):
        print(objects, end="")
        return
    for level in done.levels:
        shown = table(f"{level.name}: {level}", *page.titles(done, level.name))
        for cells in page.level_rows(done, level.name):
            shown.add_row(*cells)
        answers.print(shown)
    shown = table("Which estimator to use", *page.DECISION)
    shown.columns[2].justify = shown.columns[-1].justify = "left"
    for cells in page.decision_rows(done):
        shown.add_row(*cells)
    answers.print(shown)
    answers.print(f"picture: {drawn}; --write adds a page that explains the columns")
    if as_numbers is not None:
        as_numbers.write_text(objects, encoding="utf-8")
