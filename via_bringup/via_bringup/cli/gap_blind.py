"""`via gap blind ...`: sealed cases of a second simulator, the diagnosis run on them, and its score."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text
from via_core.errors import ViaError

from via_bringup.cli.console import answers, errors, table
from via_bringup.provenance import provenance

app = typer.Typer(help="Check the diagnosis on data whose effect is withheld.", no_args_is_help=True)

DIAGNOSE = "via gap diagnose {bag} --device {device} --json {json} --effects-out {effects}"
SIMULATE = "via gap simulate {log} --device {device} --effects {effects} --report {report} --json {json}"
Cases = Annotated[Path, typer.Argument(help="Folder of the cases.")]
Processes = Annotated[int, typer.Option(min=1, max=256, help="How many at a time.")]


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="New folder for the cases: recordings and nominal device files.")],
    keys: Annotated[Path, typer.Option(help="New folder for the keys, outside the cases.")],
    seed_from: Annotated[int, typer.Option(min=0, help="First seed; below 100000 they are for development.")] = 100_000,
    count: Annotated[int, typer.Option(min=1, max=1000, help="How many cases.")] = 240,
    duration: Annotated[float, typer.Option(min=5.0, max=600.0, help="Length of a recording [s].")] = 40.0,
    processes: Processes = 2,
) -> None:
    """Draw cases from seeds and seal their keys; prints the SHA-256 of every key."""
    from via_gap.blind.making import make_cases  # MuJoCo takes a second to load

    with _progress(count) as bar:
        made = make_cases(
            range(seed_from, seed_from + count), out, keys, duration, processes, lambda _: bar.advance(bar.task_ids[0])
        )
    for each in made:
        answers.print(f"{each.digest}  {each.name}.json")
    again = sum(each.attempts - 1 for each in made)
    errors.print(f"{len(made)} cases in {out}, their keys in {keys}; {again} draws were rejected and drawn again")


@app.command()
def run(
    cases: Cases,
    results: Annotated[Path, typer.Option(help="Folder for the reports.")],
    command: Annotated[
        str, typer.Option(help="The diagnosis: {bag}, {device}, {json}, {effects} are paths.")
    ] = DIAGNOSE,
    patience: Annotated[float, typer.Option(min=1.0, help="Longest time for one case [s].")] = 600.0,
    processes: Processes = 1,
) -> None:
    """Diagnose every case in a process of its own, on the recording alone; goes on where it was interrupted."""
    from via_gap.blind.running import run_cases
    from via_gap.blind.sealing import names_in

    with _progress(len(names_in(cases))) as bar:
        ran = run_cases(cases, results, command, patience, processes, lambda _: bar.advance(bar.task_ids[0]))
    failed = [each for each in ran if each.code != 0]
    for each in failed:
        errors.print(f"{each.name}: {each.said or f'exit code {each.code}'}")
    errors.print(f"{len(ran) - len(failed)} of {len(ran)} cases have a report in {results}")
    if failed:
        raise typer.Exit(1)


@app.command()
def score(
    cases: Cases,
    keys: Annotated[Path, typer.Option(help="Folder of the keys.")],
    results: Annotated[Path, typer.Option(help="Folder of the reports.")],
    simulate: Annotated[
        str,
        typer.Option(
            help="What measures the gap on a withheld log: {log}, {device}, {effects}, {report}, {json}; '': nothing."
        ),
    ] = SIMULATE,
    as_file: Annotated[Path | None, typer.Option("--json", help="Write every number to this file.")] = None,
    write: Annotated[Path | None, typer.Option(help="Also write gap.md and its picture into this folder.")] = None,
    processes: Processes = 2,
) -> None:
    """Open the keys, verify their seals, and score the reports; exit code 1 when a limit is missed."""
    from via_gap.blind.opening import judged_cases
    from via_gap.blind.page import as_json, write_page
    from via_gap.blind.scoring import score as score_of
    from via_gap.blind.sealing import names_in

    with _progress(len(names_in(cases))) as bar:
        judged = judged_cases(cases, keys, results, simulate, processes, lambda _: bar.advance(bar.task_ids[0]))
    scored = score_of(judged)
    listing = table(f"{len(judged)} cases", "number", "ours", "limit", "cases", "verdict")
    for number in scored.numbers:
        word = {None: "", True: "ok", False: "MISSED"}[number.kept]
        limit = "" if number.limit is None else f"{'>=' if number.at_least else '<='} {number.limit:g}"
        ours = "-" if number.value is None else f"{number.value:.3f}"
        style = {"ok": "green", "MISSED": "bold red"}.get(word, "")
        listing.add_row(number.name, ours, limit, str(number.cases), Text(word, style))
    answers.print(listing)
    if as_file is not None:
        as_file.write_text(json.dumps(as_json(scored), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if write is not None:
        try:
            write_page(scored, write, str(provenance("via gap blind score")))
        except OSError as error:
            raise ViaError(f"{write} cannot be written: {error.strerror}") from None
    if any(number.kept is False for number in scored.numbers):
        raise typer.Exit(1)


def _progress(count: int) -> Progress:
    bar = Progress(TextColumn("cases"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=errors)
    bar.add_task("cases", total=count)
    return bar
