"""Section 6: cyclic motions of arms. Each part is a module of its own; here they are one section."""

from __future__ import annotations

from pathlib import Path

from via_validation.tables import section6_bang_bang, section6_cost, section6_modal
from via_validation.tables.rows import Progress, Row

PARTS = 14  # that rows are made in, about


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Rows of 6.1 and 6.2, and what both cost."""
    done = 0

    def told(what: str) -> None:
        nonlocal done
        progress(done, PARTS, what)
        done += 1

    found = section6_modal.rows(seeds, told) + section6_bang_bang.rows(told)
    found += section6_cost.rows(told)
    progress(1, 1, "done")
    return found


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figures 16 to 18 and what belongs to them."""

    def told(what: str) -> None:
        progress(0, 1, what)

    drawn = section6_modal.pictures(folder, told) + section6_bang_bang.pictures(folder, told)
    progress(1, 1, "done")
    return drawn
