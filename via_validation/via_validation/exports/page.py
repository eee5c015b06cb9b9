"""The page of exported repairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from via_core.text_files import write_text

from via_validation.exports.exported import Exported
from via_validation.exports.reading import Lines
from via_validation.template import rendered

PAGE = "export.md"
TITLES = {"sealed": "sealed benchmark", "real": "real robots"}


@dataclass(frozen=True)
class Summary:
    """Counts of a group, and its worst figures; None without a case to state it of.

    slotted     cases with slots for all effects; `within`: MuJoCo has the gap of the report
    difference  largest of these; `reproduced`: least share of the repair among them
    lossy       cases that lose effects; `explained`: by the list of losses; `rest`: largest difference without them
    """

    name: str
    all: int
    slotted: int
    within: int
    difference: float | None
    reproduced: float | None
    lossy: int
    explained: int
    rest: float | None
    failed: int

    @staticmethod
    def of(name: str, cases: Sequence[Exported]) -> Summary:
        done = [each for each in cases if not each.failure]
        slotted = [each for each in done if not each.lost_effects]
        lossy = [each for each in done if each.lost_effects]
        shares = [share for each in slotted if (share := each.reproduced) is not None]
        return Summary(
            name, len(cases), len(slotted), sum(each.kept for each in slotted),
            max((abs(each.difference) for each in slotted), default=None), min(shares, default=None),
            len(lossy), sum(each.kept for each in lossy), max((abs(each.unlisted) for each in lossy), default=None),
            len(cases) - len(done),
        )  # fmt: skip


def summaries(cases: Sequence[Exported]) -> list[Summary]:
    """One summary per group that has cases."""
    grouped = ((title, [each for each in cases if each.group == group]) for group, title in TITLES.items())
    return [Summary.of(title, members) for title, members in grouped if members]


def write(
    cases: Sequence[Exported], readers: Mapping[str, Lines], seeds: tuple[int, int] | None, source: str, folder: Path
) -> Path:
    """Write the page into `folder`; returns its path. Raises ViaError."""
    write_text(folder / PAGE, page(cases, readers, seeds, source))
    return folder / PAGE


def page(cases: Sequence[Exported], readers: Mapping[str, Lines], seeds: tuple[int, int] | None, source: str) -> str:
    """The page as Markdown.

    readers  what readers of the files complained about, see `reading.read_all`
    seeds    least and largest seed of the sealed cases, if known
    """
    values = {
        "cases": cases, "groups": summaries(cases), "readers": readers, "losses": losses(cases), "source": source,
        "seeds": seeds, "seconds": sum(each.seconds for each in cases), "gap": _percent, "points": points,
        "percent": percent, "verdict": verdict, "sdf": any("SDF" in reader for reader in readers),
    }  # fmt: skip
    return rendered("exports/page.md", values)


def losses(cases: Sequence[Exported]) -> dict[str, list[str]]:
    """Cases of each loss but those of sensors, by its text, the most frequent first."""
    found: dict[str, list[str]] = {}
    for case in cases:
        for each in (*case.lost_effects, *case.lost_entries):
            found.setdefault(each.text.replace("|", "\\|"), []).append(case.name)
    return dict(sorted(found.items(), key=lambda item: -len(item[1])))


def verdict(case: Exported) -> str:
    """'ok', 'as listed', or 'MISSED'."""
    if not case.kept:
        return "**MISSED**"
    return "as listed" if case.lost_effects else "ok"


def points(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.3f}"


def percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.1f} %"


def _percent(gap: float) -> str:
    return f"{100.0 * gap:.3g}"
