"""Section 6: cyclic motions of arms, from the modules of its parts."""

from __future__ import annotations

from pathlib import Path

from via_validation.tables import section6_bang_bang, section6_cost, section6_modal
from via_validation.tables.rows import Progress, Row

PARTS = 14  # approximate number of progress reports


def rows(seeds: int, progress: Progress) -> list[Row]:
    """Rows of 6.1 and 6.2, and of the cost of both."""
    done = 0

    def report(what: str) -> None:
        nonlocal done
        progress(done, PARTS, what)
        done += 1

    found = section6_modal.rows(seeds, report) + section6_bang_bang.rows(report)
    found += section6_cost.rows(report)
    progress(1, 1, "done")
    return found


def pictures(folder: Path, progress: Progress) -> list[Path]:
    """Figures 16 to 18, and the releases of 6.3."""

    def report(what: str) -> None:
        progress(0, 1, what)

    drawn = section6_modal.pictures(folder, report) + section6_bang_bang.pictures(folder, report)
    progress(1, 1, "done")
    return drawn
