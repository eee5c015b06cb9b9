"""`via gap real`: diagnosis of real robots with documented causes."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_core.errors import ViaError

if TYPE_CHECKING:
    from via_validation.gap_real.cases import Case
    from via_validation.gap_real.run import Result

DATA = Path("shared") / "data"  # beside the repository


def real(
    names: Annotated[
        list[str] | None, typer.Argument(help="Cases or patterns such as 'pendulum_*'; default: all.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of the recordings; default: shared/data beside the repository.")
    ] = None,
    results: Annotated[
        Path, typer.Option(help="Folder for the result of each case; an interrupted run continues from there.")
    ] = Path("out/gap-real"),
    write: Annotated[Path | None, typer.Option(help="Write gap-real.md and its picture into this folder.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Repeat the diagnosis of cases that have a result.")] = False,
) -> None:
    """Diagnose real robots from public recordings and compare the answers with the documented causes.

    The result of a case is stored, and reused until the case or the diagnosis changes.
    """
    folder = data or Path.cwd().parent / DATA
    if not folder.is_dir():
        if data is not None:
            raise ViaError(f"no folder {data}")
        answers.print("skipped: the recordings are not beside the repository; give their folder with --data")
        return
    from via_validation.gap_real.cases import CASES  # loads numba and pydantic
    from via_validation.gap_real.run import kept, missing

    patterns = names or ["*"]
    chosen = [case for case in CASES if any(fnmatch(case.name, pattern) for pattern in patterns)]
    if not chosen:
        raise ViaError(f"no case {', '.join(patterns)}; there are: {', '.join(case.name for case in CASES)}")
    there = []
    for case in chosen:
        absent = missing(case, folder)
        if absent:
            answers.print(f"skipped {case.name}: {absent} in {folder}")
        else:
            there.append(case)
    for case in there:
        result = kept(case, results)
        if again or result is None or result.failure:
            _run(case, folder, results)
    pairs = [(case, result) for case in CASES if (result := kept(case, results)) is not None]
    _show([(case, result) for case, result in pairs if case in there])
    if write is not None and pairs:
        from via_validation.gap_real.page import write as write_page  # loads matplotlib
        from via_validation.provenance import provenance

        answers.print(f"wrote {write_page(pairs, provenance('via gap real --write docs/results'), write)}")


def _run(case: Case, folder: Path, results: Path) -> None:
    """Diagnose one case, show its progress, and store its result."""
    from via_validation.gap_real.run import keep, run_case
    from via_validation.gap_real.summary import outcome_of

    columns = (SpinnerColumn(), TextColumn("{task.percentage:3.0f} % {task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task(f"{case.name}: reading", total=1.0)
        result = run_case(
            case, folder, lambda what, share: bar.update(task, description=f"{case.name}: {what}", completed=share)
        )
    keep(result, results)
    errors.print(f"{case.name}: {outcome_of(case, result)}, {result.seconds:.0f} s of processor time")


def _show(pairs: list[tuple[Case, Result]]) -> None:
    """Print the table and the summary."""
    from via_validation.gap_real.summary import first_cause, gap_words, outcome_of, probability, summary, worse

    columns = ("case", "verdict", "first cause", "p", "explained", "held-out gap", "outcome", "worse", "s")
    rows = (
        (
            case.name,
            result.failure if result.report is None else result.report.verdict,
            first_cause(result),
            probability(result),
            f"{100 * result.report.explained:.0f} %" if result.report is not None else "",
            gap_words(result),
            outcome_of(case, result),
            worse(result),
            f"{result.seconds:.0f}",
        )
        for case, result in pairs
    )
    print_table("Real robots", columns, rows)
    answers.print(str(summary(pairs)), soft_wrap=True)
