"""`via bench soak`: the endurance test of every method, side by side, with its progress and page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import errors
from via_core.errors import ViaError

from via_validation.commands.row_table import Json, shown

if TYPE_CHECKING:
    from via_validation.bench.soak import Endurance


def soak(
    method: Annotated[list[str] | None, typer.Option(help="Only this method (repeat for more).")] = None,
    device: Annotated[str, typer.Option(help="Joint; default: one that suits the method.")] = "",
    hours: Annotated[float, typer.Option(min=0.01, max=10_000.0, help="Simulated time \\[h].")] = 24.0,
    start: Annotated[float, typer.Option(min=0.0, max=1e9, help="Stamp of the first sample \\[s].")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise, dropouts and gaps.")] = 0,
    as_rows: Json = None,
    write: Annotated[Path | None, typer.Option(help="Also write soak.md into this folder.")] = None,
) -> None:
    """Simulated hours at 1 kHz: finite numbers, bounded errors and memory. A day takes minutes per method."""
    from via_core.devices import load_device
    from via_estimators.methods import METHODS, method_for

    from via_validation.bench.estimators import device_for
    from via_validation.bench.soak import soak_rows, work, write_markdown
    from via_validation.provenance import provenance
    from via_validation.side_by_side import side_by_side

    chosen = [method_for(load_device(device), name) if device else name for name in method or METHODS]
    words = ["via bench soak", f"--hours {hours:g}", *(f"--method {name}" for name in method or [])]
    words += (
        [f"--device {device}"] * bool(device) + [f"--start {start:g}"] * bool(start) + [f"--seed {seed}"] * bool(seed)
    )
    joints = [load_device(device) if device else device_for(name) for name in chosen]
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    done: dict[int, Endurance] = {}
    tenths = [0] * len(chosen)  # last progress printed of each run, without a terminal
    with Progress(*columns, console=errors, disable=not errors.is_terminal) as bars:
        tasks = [bars.add_task(name, total=hours, start=False) for name in chosen]

        def receive(number: int, sent: float | Endurance | ViaError) -> None:
            if isinstance(sent, ViaError):
                raise sent
            if isinstance(sent, float | int):
                bars.update(tasks[number], completed=sent)
                if not errors.is_terminal and (tenth := min(int(10.0 * sent / hours), 10)) > tenths[number]:
                    tenths[number] = tenth
                    errors.print(f"{chosen[number]}: {10 * tenth} %")
                return
            done[number] = sent
            if write is not None:
                missing = [name for at, name in enumerate(chosen) if at not in done]
                write_markdown(_in_order(done), missing, provenance(" ".join(words)), write / "soak.md")

        jobs = [(work, (joint, name, hours, start, seed)) for joint, name in zip(joints, chosen, strict=True)]
        complete = side_by_side(jobs, receive, lambda number: bars.start_task(tasks[number]), lambda _: None)
    shown("Endurance", [row for run in _in_order(done) for row in soak_rows(run)], as_rows)
    if not complete:
        raise typer.Exit(130)
    if lost := [name for number, name in enumerate(chosen) if number not in done]:
        raise ViaError(f"ended early, without a result: {', '.join(lost)}")


def _in_order(done: dict[int, Endurance]) -> list[Endurance]:
    return [done[number] for number in sorted(done)]
