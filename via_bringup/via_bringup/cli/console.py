"""Consoles of the `via` command: `answers` prints results to stdout, `errors` everything else to stderr.

Markup is off: brackets and colons in file and topic names are printed literally.
"""

from __future__ import annotations

import sys

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

WIDTH = 160  # characters per line if stdout is not a terminal

answers = Console(
    markup=False, emoji=False, highlight=False, width=None if sys.stdout and sys.stdout.isatty() else WIDTH
)
errors = Console(stderr=True, markup=False, emoji=False, highlight=False)


def table(title: str, *columns: str) -> Table:
    """An empty table. The first column holds names: left-aligned and never truncated. The others are right-aligned."""
    made = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        made.add_column(column, justify="left" if number == 0 else "right", no_wrap=number == 0, overflow="fold")
    return made
