"""Section 6: cyclic motions of arms. Each part is a module of its own; here they are one section."""

from __future__ import annotations

from pathlib import Path

from via_bringup.tables import section6_modal
from via_bringup.tables.rows import Progress, Row

PARTS = 5  # that rows are made in, about


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Rows of 6.1."""
    done = 0

    def told(what: str) -> None:
        nonlocal done
        progress(done, PARTS, what)
        done += 1

    found = section6_modal.rows(seeds, told)
    progress(1, 1, "done")
    return found


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figure 16 and what belongs to it."""

    def told(what: str) -> None:
        progress(0, 1, what)

    drawn = section6_modal.pictures(folder, told)
    progress(1, 1, "done")
    return drawn
