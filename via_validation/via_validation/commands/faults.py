"""`via faults`: the status of every estimator on faulty and on sound signals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track
from via_bringup.cli.console import answers, errors, print_table
from via_core.devices import load_device

PAGE = "faults.md"


def faults(
    device: Annotated[
        list[str] | None, typer.Option(help="Device with a torque equation (repeat for more); default: six devices.")
    ] = None,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} and its picture into this folder.")] = None,
) -> None:
    """Feed faulty and sound signals to every estimator and report its status."""
    from via_validation.compare import faults as experiment  # loads every estimator and the simulator
    from via_validation.compare import faults_page as page
    from via_validation.provenance import provenance

    chosen = [load_device(name) for name in device or experiment.DEVICES]
    recorded = {each.name: experiment.moved(each) for each in chosen}
    work = [(each, name) for each in chosen for name in experiment.faults_of(each)]
    faulty = [
        experiment.fault_result(each, name, recorded[each.name])
        for each, name in track(work, "faulty signals", console=errors)
    ]
    work = [(each, name) for each in chosen if each.n_motors for name in experiment.variations_of(each)]
    sound = [experiment.sound_result(each, name) for each, name in track(work, "sound signals", console=errors)]
    for name, titles, rows in page.fault_tables(faulty):
        print_table(f"{name}: OK samples by method", [title.strip("`") for title in titles], _plain(rows))
    for titles, rows in page.sound_tables(sound):
        print_table("sound joints: IMPLAUSIBLE samples", titles, _plain(rows))
    if write is not None:
        words = ["via faults", *(f"--device {name}" for name in device or [])]
        page.draw(faulty, sound, write / "faults.png")
        page.write(faulty, sound, provenance(" ".join(words)), "faults.png", write / PAGE)
        answers.print(f"page: {write / PAGE}")


def _plain(rows: list[list[str]]) -> list[list[str]]:
    """The cells without the asterisks of Markdown."""
    return [[cell.strip("*") for cell in cells] for cells in rows]
