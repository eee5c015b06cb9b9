"""Page of the damaged files: counts and faults by kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from via_validation.fuzz.run import BATCH, PATIENCE, Result
from via_validation.provenance import Provenance
from via_validation.template import write_page


def write(found: Mapping[str, Result], missing: Sequence[str], seed: int, source: Provenance, path: Path) -> None:
    """Write the page of the results by kind; `missing` kinds have not been run yet."""
    rows = [
        (name, each.files, each.read, each.refused, len(each.faults), f"{each.growth:.1f}")
        for name, each in found.items()
    ]
    values = {
        "rows": rows,
        "total": sum(each.files for each in found.values()),
        "read": sum(each.read for each in found.values()),
        "refused": sum(each.refused for each in found.values()),
        "faults": [fault.replace("`", "'") for each in found.values() for fault in each.faults],
        "missing": missing,
        "seed": seed,
        "source": source,
        "batch": BATCH,
        "patience": PATIENCE,
    }
    write_page(path, "fuzz/fuzz.md", values)
