"""Where the command prints: answers to stdout, everything else to stderr."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

answers = Console()
errors = Console(stderr=True)


def table(title: str, *columns: str) -> Table:
    """An empty table whose columns are right-aligned but for the first."""
    made = Table(title=title, title_justify="left", header_style="bold")
    for number, column in enumerate(columns):
        made.add_column(column, justify="left" if number == 0 else "right")
    return made
