"""`via mutants`: whether the tests notice small errors in the numerical heart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_bringup.commit import git
from via_core.errors import ViaError

PAGE = "mutants.md"


def mutants(
    count: Annotated[int, typer.Option(min=0, help="Mutations in the sample, in addition to the named ones.")] = 200,
    seed: Annotated[int, typer.Option(help="Of the sample.")] = 0,
    processes: Annotated[int, typer.Option(min=1, max=64, help="Mutations tried at the same time.")] = 2,
    seconds: Annotated[float, typer.Option(min=1.0, help="Tests per mutation, as they run without it \\[s].")] = 120.0,
    per_file: Annotated[float, typer.Option(min=1.0, help="Longest test file that is used \\[s].")] = 60.0,
    module: Annotated[str, typer.Option(help="Only modules whose path contains this text.")] = "",
    out: Annotated[Path, typer.Option(help="Folder for the mutated copies; new or empty.")] = Path("out/mutants"),
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} into this folder.")] = None,
) -> None:
    """Plant small errors in the numerical heart and count those that the tests notice (hours for 200)."""
    from via_validation.mutants import choice, page, running
    from via_validation.provenance import provenance

    root = _checkout()
    found = {name: each for name, each in choice.candidates(root).items() if module in name}
    named = [mutation for mutation, _ in choice.listed(root, "named") if module in mutation.path]
    equivalent = {mutation for mutation, _ in choice.listed(root, "equivalent")}
    sample, limits = choice.sampled(found, count, seed), running.Limits(seconds, per_file)
    work = [each for each in (*sample, *named) if each not in equivalent]
    bars = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*bars, console=errors) as bar:
        task = bar.add_task("mutations", total=len(work))

        def report(outcome: running.Outcome) -> None:
            each = outcome.mutation
            word = f"killed by {outcome.killed_by}" if outcome.killed_by else f"SURVIVED {outcome.files} test files"
            errors.print(f"{each.path}:{each.line}: {each.before!r} -> {each.after!r} in {each.code!r}: {word}")
            bar.advance(task)

        done = running.tried(work, root, out.resolve(), processes, limits, report)
    by_mutation = {each.mutation: each for each in done}
    outcomes = [
        [by_mutation.get(each) or running.Outcome(each, "", 0, 0.0) for each in part] for part in (sample, named)
    ]
    available = sum(map(len, found.values()))
    results = page.Results(outcomes[0], outcomes[1], equivalent, available, len(found), seed, limits)
    columns = ("", "mutations", "killed", "equivalent", "survived", "killed of not equivalent")
    print_table("Mutations", columns, page.summary(results))
    for outcome in results.survivors:
        each = outcome.mutation
        answers.print(f"survived: {each.path}:{each.line}: {each.before!r} -> {each.after!r} in {each.code!r}")
    if write is not None:
        words = f"via mutants --count {count} --seed {seed} --seconds {seconds:g} --per-file {per_file:g}"
        page.write(results, provenance(f"{words} --module {module}" if module else words), write / PAGE)
        answers.print(f"page: {write / PAGE}")


def _checkout() -> Path:
    """The root of the repository that contains this file; raises ViaError outside a checkout."""
    root = git("rev-parse", "--show-toplevel").strip()
    if not root:
        raise ViaError("mutations need a checkout of the repository: clone it and run the command there")
    return Path(root)
