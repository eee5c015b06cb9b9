"""`via gap blind ...`: make sealed cases with a second simulator, diagnose them, and score the answers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
import yaml
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_bringup.cli.options import saved_report
from via_core.errors import ViaError
from via_gap.selection.reliability import decisive

from via_validation.calibration import Calibrated, calibrated
from via_validation.commands.row_table import coloured, save_json
from via_validation.provenance import provenance

app = typer.Typer(
    help="Evaluate the diagnosis on sealed cases of a second simulator.", no_args_is_help=True, add_completion=False
)

DIAGNOSE = "via gap diagnose {bag} --device {device} --json {json} --effects-out {effects}"
SEED = 101_640  # first seed of a block; a block contains every named effect equally often
MEASURE = "via gap blind measure {log} --device {device} --report {report} --json {json}"
Cases = Annotated[Path, typer.Argument(help="Folder of the cases.")]
Processes = Annotated[int, typer.Option(min=1, max=256, help="Number of parallel processes.")]


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="New folder for the cases: recordings and nominal device files.")],
    keys: Annotated[Path, typer.Option(help="New folder for the keys, outside the cases.")],
    seed_from: Annotated[int, typer.Option(min=0, help="First seed; seeds below 100000 are for development.")] = SEED,
    count: Annotated[int, typer.Option(min=1, max=1000, help="Number of cases.")] = 376,
    duration: Annotated[float, typer.Option(min=5.0, max=600.0, help="Duration of a recording \\[s].")] = 40.0,
    processes: Processes = 2,
) -> None:
    """Draw cases from seeds and seal their keys; prints the SHA-256 of every key."""
    from via_validation.sealed.making import make_cases  # MuJoCo takes a second to load

    with progress(count) as bar:
        made = make_cases(
            range(seed_from, seed_from + count), out, keys, duration, processes, lambda _: bar.advance(bar.task_ids[0])
        )
    for each in made:
        answers.print(f"{each.digest}  {each.name}.json")
    rejected = sum(each.attempts - 1 for each in made)
    errors.print(f"{len(made)} cases in {out}, their keys in {keys}; {rejected} draws were rejected")


@app.command()
def run(
    cases: Cases,
    results: Annotated[Path, typer.Option(help="Folder for the reports.")],
    command: Annotated[
        str, typer.Option(help="Command of the diagnosis; {bag}, {device}, {json}, {effects} are replaced by paths.")
    ] = DIAGNOSE,
    patience: Annotated[float, typer.Option(min=1.0, help="Time limit of a case \\[s].")] = 600.0,
    processes: Processes = 1,
) -> None:
    """Diagnose every case in a separate process from its recording alone; continues an interrupted run."""
    from via_validation.sealed.running import run_cases
    from via_validation.sealed.sealing import names_in

    with progress(len(names_in(cases))) as bar:
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
            help="Command to measure the gap on a withheld log: {log}, {device}, {effects}, {report}, {json}; '': none."
        ),
    ] = MEASURE,
    as_file: Annotated[Path | None, typer.Option("--json", help="Write every number to this file.")] = None,
    write: Annotated[
        Path | None, typer.Option(help="Also write gap.md, gap-cases.md and a picture into this folder.")
    ] = None,
    processes: Processes = 2,
) -> None:
    """Open the keys, verify their seals, and score the reports; exit code 1 when a limit is missed."""
    from via_validation.sealed.opening import evaluated_cases
    from via_validation.sealed.page import as_json, write_page
    from via_validation.sealed.scoring import score as score_of
    from via_validation.sealed.sealing import names_in

    with progress(len(names_in(cases))) as bar:
        evaluations = evaluated_cases(cases, keys, results, simulate, processes, lambda _: bar.advance(bar.task_ids[0]))
    scored = score_of(evaluations)
    rows = []
    for number in scored.numbers:
        limit = "" if number.limit is None else f"{'>=' if number.at_least else '<='} {number.limit:g}"
        ours = "-" if number.value is None else f"{number.value:.3f}"
        verdict = coloured({None: "", True: "ok", False: "MISSED"}[number.kept])
        rows.append((number.group, number.name, ours, limit, str(number.cases), verdict))
    print_table(f"{len(evaluations)} cases", ("group", "number", "ours", "limit", "cases", "verdict"), rows)
    save_json(as_json(scored), as_file)
    if write is not None:
        try:
            write_page(scored, write, str(provenance("via gap blind score")))
        except OSError as error:
            raise ViaError(f"{write} cannot be written: {error.strerror}") from None
    if any(number.kept is False for number in scored.numbers):
        raise typer.Exit(1)


@app.command()
def calibrate(
    cases: Cases,
    keys: Annotated[Path, typer.Option(help="Folder of the keys.")],
    results: Annotated[Path, typer.Option(help="Folder of the reports.")],
    write: Annotated[Path, typer.Option(help="File for the counts, in via_gap: selection/reliability.yaml.")],
) -> None:
    """Count right answers by verdict on development cases; thresholds of conformal sets, and widths of intervals."""
    from via_validation.sealed.evaluation import evaluate
    from via_validation.sealed.sealing import names_in, opened

    answered, seeds = [], []
    for name in names_in(cases):
        file = results / f"{name}.json"
        if not file.exists():
            continue
        report, key = saved_report(file), opened(name, cases, keys).key
        if key["seed"] >= SEED:
            raise ViaError(f"{name}: seed {key['seed']} is reserved for evaluation; calibrate with seeds below {SEED}")
        causes = [(each["effect"], each["site"], each["motor"]) for each in key["effects"]]
        shares = {(c.effect, c.site, c.motor): c.share for c in report.causes}
        evaluated = evaluate(name, key, json.loads(report.to_json()), None, None)
        truth = min((shares.get(cause, 0.0) for cause in causes), default=None) if key["kind"] != "unknown" else None
        distances = tuple(each.distance for each in evaluated.inside)
        left = decisive(report.causes[0].left, report.transfer) if report.causes else None
        answered.append(
            Calibrated(
                report.verdict, report.level, left, evaluated.first_right, truth, distances, widened=report.widened
            )
        )
        seeds.append(int(key["seed"]))
    if not answered:
        raise ViaError(f"no report in {results}")
    origin = str(provenance("via gap blind calibrate"))
    numbers = calibrated(answered, origin, f"{min(seeds)} to {max(seeds)}")
    write.write_text(yaml.safe_dump(numbers.model_dump(), sort_keys=False), encoding="utf-8")
    answers.print(f"{len(answered)} answers counted; numbers in {write}")


@app.command()
def measure(
    log: Annotated[Path, typer.Argument(help="Bag folder, .mcap or .csv file.")],
    device: Annotated[str, typer.Option(help="Nominal device: name or path to its YAML.")],
    report: Annotated[Path, typer.Option(help="Report of a diagnosis: the repair to apply.")],
    as_file: Annotated[Path, typer.Option("--json", help="Write `before`, `after` and `floor` to this file.")],
) -> None:
    """Measure the gap of a withheld log before and after the repair of a report."""
    from via_validation.withheld_gap import gap_of_repair

    gap = gap_of_repair(log, device, saved_report(report))
    as_file.write_text(json.dumps(gap, allow_nan=False) + "\n", encoding="utf-8")
    answers.print(f"gap {gap['before']:.4g} before, {gap['after']:.4g} after")


def progress(count: int) -> Progress:
    bar = Progress(TextColumn("cases"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=errors)
    bar.add_task("cases", total=count)
    return bar
