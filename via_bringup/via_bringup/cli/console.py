"""Where the command prints: answers to stdout, everything else to stderr.

Texts appear as they are: the brackets and colons in the name of a file or a topic are no markup.
"""

from __future__ import annotations

import sys

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

WIDE = 160  # characters of a line where no terminal says how many fit

answers = Console(
    markup=False, emoji=False, highlight=False, width=None if sys.stdout and sys.stdout.isatty() else WIDE
)
errors = Console(stderr=True, markup=False, emoji=False, highlight=False)


def table(title: str, *columns: str) -> Table:
    """An empty table whose columns are right-aligned but for the first, which holds names and is never cut short."""
    made = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        made.add_column(column, justify="left" if number == 0 else "right", no_wrap=number == 0, overflow="fold")
    return made
