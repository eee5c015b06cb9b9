"""`via compare`: all stiffness estimators on the same joints, motion and noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_core.devices import load_device
from via_core.errors import ViaError

from via_validation.commands.row_table import STDOUT, save_json

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
    if as_numbers != STDOUT:
        for level in done.levels:
            print_table(f"{level.name}: {level}", page.titles(done, level.name), page.level_rows(done, level.name))
        texts = (page.DECISION[2], page.DECISION[-1])
        print_table("Which estimator to use", page.DECISION, page.decision_rows(done), texts=texts)
        answers.print(f"picture: {drawn}; --write adds a page that explains the columns")
    save_json(page.as_json(done, source), as_numbers)
