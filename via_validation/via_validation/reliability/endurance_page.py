"""Page of a run of the live graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from via_validation.provenance import Provenance
from via_validation.reliability.endurance import DEVICE, DRIFT, GROWTH, Run
from via_validation.tables.page import number, verdict
from via_validation.tables.rows import Row
from via_validation.template import write_page


def write(run: Run, rows: Sequence[Row], source: Provenance, path: Path) -> None:
    """Write the page of one run."""
    values = {
        "rows": [(each.what, each.quantity, number(each.ours), number(each.limit), verdict(each)) for each in rows],
        "missed": [each.what for each in rows if each.ok is False],
        "device": DEVICE.name,
        "rate": f"{run.rate:g}",
        "minutes": f"{run.seconds / 60.0:.1f}",
        "growth": GROWTH,
        "drift": round(100.0 * (DRIFT - 1.0)),
        "source": source,
    }
    write_page(path, "reliability/endurance.md", values)
