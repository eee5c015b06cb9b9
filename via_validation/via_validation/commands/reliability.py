"""`via reliability`: faults injected into the live graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from via_bringup.cli.console import answers, errors, print_table
from via_core.errors import ParameterError

PAGE = "reliability.md"
INTERRUPTED = 130


def reliability(
    group: Annotated[list[str] | None, typer.Option(help="Begin of a group's title (repeat for more).")] = None,
    fault: Annotated[list[str] | None, typer.Option(help="Part of what is injected (repeat for more).")] = None,
    quick: Annotated[bool, typer.Option(help="Only faults that take a few seconds.")] = False,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} into this folder, after every fault.")] = None,
) -> None:
    """Inject faults into the live graph and check what each node does (five minutes).

    The exit code is 1 if a requirement is missed. After an interrupt the page has what was found.
    """
    from via_validation.provenance import provenance
    from via_validation.reliability import page  # loads every node
    from via_validation.reliability.fault import Outcome
    from via_validation.reliability.run import Name, groups, outcomes

    words = ["via reliability", *(f"--group '{each}'" for each in group or [])]
    words += [*(f"--fault '{each}'" for each in fault or []), *(["--quick"] if quick else [])]
    chosen = [
        Name(title, each.injected)
        for title, faults in groups().items()
        for each in faults
        if (group is None or any(title.startswith(begin) for begin in group))
        and (fault is None or any(part in each.injected for part in fault))
        and (each.quick or not quick)
    ]
    if not chosen:
        raise ParameterError(f"no such fault; groups: {', '.join(groups())}")
    source, found, interrupted = provenance(" ".join(words)), list[Outcome](), False
    columns = TextColumn("{task.completed} of {task.total}: {task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task(chosen[0].injected, total=len(chosen))
        try:
            for outcome in outcomes(chosen):
                found.append(outcome)
                if not outcome.met:
                    errors.print(f"missed: {outcome.injected}: {outcome.seen}")
                following = chosen[len(found)].injected if len(found) < len(chosen) else ""
                bar.update(task, completed=len(found), description=following)
                if write is not None:
                    page.write(found, chosen[len(found) :], source, write / PAGE)
        except KeyboardInterrupt:
            interrupted = True
    rows = ((each.injected, "yes" if each.met else "no", each.seen, f"{each.seconds:.1f}") for each in found)
    print_table("faults", ("injected", "as required", "seen", "time [s]"), rows)
    answers.print(f"{sum(each.met for each in found)} of {len(found)} faults do what they must")
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if not all(each.met for each in found):
        raise typer.Exit(1)
