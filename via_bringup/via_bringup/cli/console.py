"""Consoles of the `via` command: `answers` prints results to stdout, `errors` everything else to stderr.

Markup is off: brackets and colons in file and topic names are printed literally. Characters that control a terminal are
printed as their pictures: names in files of others may contain them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from math import isnan
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text
from via_core.text_files import shown

WIDTH = 160  # characters per line if stdout is not a terminal


class HarmlessConsole(Console):
    """A console whose texts do not control the terminal."""

    def print(self, *objects: Any, **options: Any) -> None:
        super().print(*map(_harmless, objects), **options)


class HarmlessTable(Table):
    """A table whose cells do not control the terminal."""

    def add_row(self, *cells: Any, **options: Any) -> None:
        super().add_row(*map(_harmless, cells), **options)


def _harmless(given: Any) -> Any:
    if isinstance(given, Text):
        given.plain = shown(given.plain)  # of the same length: styles stay in place
    return shown(given) if isinstance(given, str) else given


answers = HarmlessConsole(
    markup=False, emoji=False, highlight=False, width=None if sys.stdout and sys.stdout.isatty() else WIDTH
)
errors = HarmlessConsole(stderr=True, markup=False, emoji=False, highlight=False)


def table(title: str, *columns: str, names: int = 1, texts: Collection[str] = ()) -> Table:
    """An empty table whose columns are right-aligned, except for names and texts.

    names  so many first columns hold names: left-aligned and never truncated
    texts  columns that hold texts: left-aligned and folded
    """
    made = HarmlessTable(title=shown(title), title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        left = number < names or column in texts
        made.add_column(column, justify="left" if left else "right", no_wrap=number < names, overflow="fold")
    return made


def print_table(
    title: str, columns: Iterable[str], rows: Iterable[Iterable[Any]], names: int = 1, texts: Collection[str] = ()
) -> None:
    """Print a table with these rows of cells; `names` and `texts` as in `table`."""
    made = table(title, *columns, names=names, texts=texts)
    for cells in rows:
        made.add_row(*cells)
    answers.print(made)


@contextmanager
def working(text: str) -> Iterator[Callable[[str, float], None]]:
    """Show what is done and for how long; the function given takes a step and the share done, NaN if unknown.

    Without a terminal nothing is shown.
    """
    columns = (SpinnerColumn(), TextColumn("{task.fields[share]}{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(text, total=None, share="")

        def show(step: str, share: float) -> None:
            bar.update(task, description=step, share="" if isnan(share) else f"{100.0 * share:3.0f} % ")

        yield show
