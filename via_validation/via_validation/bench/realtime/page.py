"""Page of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from via_validation.bench.realtime.loop import MESSAGES, METHODS
from via_validation.bench.realtime.rclcpp import missing
from via_validation.bench.realtime.rows import PROCESSES, RUNS, WAYS, Loops
from via_validation.provenance import Provenance
from via_validation.tables.page import number, verdict
from via_validation.tables.rows import Row
from via_validation.template import write_page


def write(loops: Loops, rows: Sequence[Row], source: Provenance, path: Path) -> None:
    """Write the page; `rows` are all rows, those of the loops first."""
    by_run = {(way, processes): _of(rows, f"realtime.{way}.{processes}.") for way, processes in RUNS}
    quantities = [row.quantity for row in by_run[RUNS[0]]]
    values = {
        "runs": [f"{WAYS[way]}, {PROCESSES[processes]}" for way, processes in RUNS],
        "table": [(name, *(number(by_run[each][k].ours) for each in RUNS)) for k, name in enumerate(quantities)],
        "limits": [each for each in rows if each.limit is not None],
        "node": _of(rows, "node."),
        "missed": [f"{each.what}: {each.quantity}" for each in rows if each.ok is False],
        "granted": loops[RUNS[0]].granted,
        "settings": rows[0].settings,
        "methods": METHODS,
        "messages": MESSAGES,
        "rclcpp": missing(),
        "source": source,
    }
    write_page(path, "bench/realtime/page.md", values, {"number": number, "verdict": verdict})


def _of(rows: Sequence[Row], start: str) -> list[Row]:
    return [each for each in rows if each.id.startswith(start)]
