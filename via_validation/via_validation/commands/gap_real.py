"""`via gap real`: what the diagnosis says of real robots whose causes are documented."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, table
from via_core.errors import ViaError

if TYPE_CHECKING:
    from via_validation.gap_real.cases import Case
    from via_validation.gap_real.run import Result

DATA = Path("shared") / "data"  # beside the repo


def real(
    names: Annotated[
        list[str] | None, typer.Argument(help="Cases, patterns such as 'pendulum_*' among them; else all.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of the recordings; else shared/data beside the repo.")
    ] = None,
    results: Annotated[
        Path, typer.Option(help="Folder that keeps the result of each case; an interrupted run goes on from there.")
    ] = Path("out/gap-real"),
    write: Annotated[Path | None, typer.Option(help="Write gap-real.md and its picture into this folder.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Diagnose anew what has a result already.")] = False,
) -> None:
    """Diagnose real robots from public recordings and compare the answers with the documented causes.

    Results are kept per case. A result is used again until the case or the diagnosis changes.
    """
    folder = data or Path.cwd().parent / DATA
    if not folder.is_dir():
        if data is not None:
            raise ViaError(f"no folder {data}")
        answers.print("skipped: the recordings are not beside the repo; name their folder with --data")
        return
    from via_validation.gap_real.cases import CASES  # what follows loads numba and pydantic models
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
        from via_bringup.provenance import provenance

        from via_validation.gap_real.page import write as write_page  # loads matplotlib

        answers.print(f"wrote {write_page(pairs, provenance('via gap real --write docs/results'), write)}")


def _run(case: Case, folder: Path, results: Path) -> None:
    """Diagnose one case, show its progress, keep its result."""
    from via_validation.gap_real.run import keep, run_case

    columns = (SpinnerColumn(), TextColumn("{task.percentage:3.0f} % {task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task(f"{case.name}: reading", total=1.0)
        result = run_case(
            case, folder, lambda what, share: bar.update(task, description=f"{case.name}: {what}", completed=share)
        )
    keep(result, results)
    errors.print(f"{case.name}: {_judgement(case, result)}, {result.seconds:.0f} s of processor time")


def _show(pairs: list[tuple[Case, Result]]) -> None:
    """The table and the summary."""
    from via_validation.gap_real.summary import first_cause, gap_words, summary, worse

    shown = table(
        "Real robots", "case", "verdict", "first cause", "p", "explained", "gap held out", "judged", "worse", "s"
    )
    for case, result in pairs:
        report = result.report
        first = report.causes[0] if report is not None and report.causes else None
        shown.add_row(
            case.name,
            result.failure if report is None else report.verdict,
            first_cause(result),
            f"{first.probability:.2f}" if first else "",
            f"{100 * report.explained:.0f} %" if report is not None else "",
            gap_words(result),
            _judgement(case, result),
            worse(result),
            f"{result.seconds:.0f}",
        )
    answers.print(shown)
    answers.print(str(summary(pairs)), soft_wrap=True)


def _judgement(case: Case, result: Result) -> str:
    from via_validation.gap_real.summary import judged

    return judged(case, result)
