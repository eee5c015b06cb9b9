"""Rows as HTML and Markdown pages with rounded numbers, and as JSON with full precision."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

from PIL import Image

from via_validation.provenance import Provenance
from via_validation.tables.rows import Row
from via_validation.tables.run import Finished
from via_validation.template import rendered

PICTURE_BYTES = 150_000  # largest picture on a page of the repository
LARGEST_COUNT = 1e12  # whole numbers beyond it are measurements


@dataclass(frozen=True)
class Report:
    """Content of a page."""

    sections: tuple[Finished, ...]
    seeds: int
    provenance: Provenance

    @property
    def rows(self) -> tuple[Row, ...]:
        return tuple(row for section in self.sections for row in section.rows)

    def of_page(self, name: str) -> tuple[Finished, ...]:
        """The sections of this page."""
        return tuple(each for each in self.sections if each.section.page == name)

    @property
    def missed(self) -> tuple[Row, ...]:
        return tuple(row for row in self.rows if row.ok is False)

    @property
    def limited(self) -> int:
        """Number of rows with a limit."""
        return sum(row.ok is not None for row in self.rows)


def number(value: float | None) -> str:
    """The value with four digits, a whole number with all of them; a dash for a missing or infinite one."""
    if value is None or not isfinite(value):
        return "-"
    return f"{value:.0f}" if value == round(value) and abs(value) < LARGEST_COUNT else f"{value:.4g}"


def verdict(row: Row) -> str:
    """Verdict of a row; for 'not reproduced' the remark states the reason."""
    if row.ok is None:
        return "shown" if row.ours is not None else "not reproduced"
    return "ok" if row.ok else "MISSED"


def as_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows as JSON objects {id, what, quantity, document, ours, limit, settings, seeds, remark, ok}; NaN is null."""
    objects = []
    for row in rows:
        values = {item.name: getattr(row, item.name) for item in fields(Row)}
        for name in ("document", "ours", "limit"):
            value = values[name]
            values[name] = None if value is None or not isfinite(value) else float(value)
        objects.append({**values, "seeds": int(row.seeds), "ok": None if row.ok is None else bool(row.ok)})
    return objects


def write_html(report: Report, path: Path) -> None:
    """Write the HTML page; its pictures are in folders named by section beside it."""
    path.write_text(_rendered("page.html", report, path.parent, escape=True), encoding="utf-8")


def write_markdown(report: Report, folder: Path) -> list[Path]:
    """Write one <page>.md per page of the report's sections; returns their paths.

    Small copies of the pictures are written to a folder with the page's name.
    """
    names = dict.fromkeys(each.section.page for each in report.sections)
    return [_write_page(replace(report, sections=report.of_page(name)), folder / f"{name}.md") for name in names]


def _write_page(report: Report, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pictures = path.parent / path.stem
    shutil.rmtree(pictures, ignore_errors=True)
    copied = []
    for section in report.sections:
        targets = tuple(pictures / f"{section.section.name}_{picture.name}" for picture in section.pictures)
        for picture, target in zip(section.pictures, targets, strict=True):
            pictures.mkdir(exist_ok=True)
            small_copy(picture, target)
        copied.append(replace(section, pictures=targets))
    text = _rendered("page.md", replace(report, sections=tuple(copied)), path.parent, escape=False)
    path.write_text(text, encoding="utf-8")
    return path


def small_copy(picture: Path, target: Path) -> None:
    """Save the picture as an indexed PNG of at most PICTURE_BYTES; shrinks it if necessary."""
    image = Image.open(picture).convert("RGB")
    while True:
        image.quantize(128).save(target, optimize=True)
        if target.stat().st_size <= PICTURE_BYTES:
            return
        image = image.resize((image.width * 4 // 5, image.height * 4 // 5))


def _rendered(template: str, report: Report, folder: Path, escape: bool) -> str:
    filters: dict[str, Callable[..., Any]] = {"number": number, "verdict": verdict, "cell": _cell}
    filters["beside"] = lambda path: path.relative_to(folder).as_posix()
    return rendered(f"tables/{template}", {"r": report}, filters, escape)


def _cell(text: str) -> str:
    """The text escaped for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
