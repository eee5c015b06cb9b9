"""Page of the injected faults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from via_validation.provenance import Provenance
from via_validation.reliability.fault import Outcome
from via_validation.reliability.run import Name
from via_validation.template import write_page


def write(found: Sequence[Outcome], missing: Sequence[Name], source: Provenance, path: Path) -> None:
    """Write the page of all outcomes by group; `missing` faults have not been injected yet."""
    groups = {group: [each for each in found if each.group == group] for group in dict.fromkeys(e.group for e in found)}
    values = {
        "groups": {group: [_row(each) for each in own] for group, own in groups.items()},
        "met": {group: sum(each.met for each in own) for group, own in groups.items()},
        "total": len(found),
        "all_met": sum(each.met for each in found),
        "missed": [f"{each.group}: {each.injected}" for each in found if not each.met],
        "missing": [f"{each.group}: {each.injected}" for each in missing],
        "source": source,
    }
    write_page(path, "reliability/reliability.md", values)


def _row(outcome: Outcome) -> list[str]:
    seen = outcome.seen if outcome.met else f"**missed:** {outcome.seen}"
    return [each.replace("|", "\\|") for each in (outcome.injected, outcome.must, seen)]
