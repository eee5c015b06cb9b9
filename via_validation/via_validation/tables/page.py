"""Rows as a page, as JSON and as words: the same numbers, rounded for readers, whole for machines."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from math import isfinite
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from PIL import Image
from via_bringup.provenance import Provenance

from via_validation.tables.rows import Row
from via_validation.tables.run import Finished

PICTURE_BYTES = 150_000  # more than this a picture may not add to a repository


@dataclass(frozen=True)
class Report:
    """All there is to tell."""

    sections: tuple[Finished, ...]
    seeds: int
    provenance: Provenance

    @property
    def rows(self) -> tuple[Row, ...]:
        return tuple(row for section in self.sections for row in section.rows)

    def of_page(self, name: str) -> tuple[Finished, ...]:
        """The sections that stand on this page."""
        return tuple(each for each in self.sections if each.section.page == name)

    @property
    def missed(self) -> tuple[Row, ...]:
        return tuple(row for row in self.rows if row.ok is False)

    @property
    def judged(self) -> int:
        return sum(row.ok is not None for row in self.rows)


def number(value: float | None) -> str:
    """Four digits are more than noise leaves; a dash where there is no number."""
    return "-" if value is None or not isfinite(value) else f"{value:.4g}"


def verdict(row: Row) -> str:
    """One word; a row without a number of ours that is not judged has its reason in the remark."""
    if row.ok is None:
        return "shown" if row.ours is not None else "not reproduced"
    return "ok" if row.ok else "MISSED"


def as_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows as JSON objects {id, what, quantity, document, ours, limit, settings, seeds, remark, ok}; no NaN: null."""
    objects = []
    for row in rows:
        values = {item.name: getattr(row, item.name) for item in fields(Row)}
        for name in ("document", "ours", "limit"):
            value = values[name]
            values[name] = None if value is None or not isfinite(value) else float(value)
        objects.append({**values, "seeds": int(row.seeds), "ok": None if row.ok is None else bool(row.ok)})
    return objects


def write_html(report: Report, path: Path) -> None:
    """The page that shows it all; its pictures lie beside it already, in folders named by section."""
    path.write_text(_rendered("page.html", report, path.parent, escape=True), encoding="utf-8")


def write_markdown(report: Report, folder: Path) -> list[Path]:
    """A repository's pages, <page>.md of every page that sections of the report stand on; returns their paths.

    Each has copies of its pictures, small enough for a repository, in a folder of the page's name.
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
    """The picture as an indexed PNG; shrunk until it is small enough."""
    image = Image.open(picture).convert("RGB")
    while True:
        image.quantize(128).save(target, optimize=True)
        if target.stat().st_size <= PICTURE_BYTES:
            return
        image = image.resize((image.width * 4 // 5, image.height * 4 // 5))


def _rendered(template: str, report: Report, folder: Path, escape: bool) -> str:
    environment = Environment(
        autoescape=escape, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters.update(
        number=number, verdict=verdict, beside=lambda path: path.relative_to(folder).as_posix(), cell=_cell
    )
    return environment.from_string(files("via_validation.tables").joinpath(template).read_text("utf-8")).render(
        r=report
    )


def _cell(text: str) -> str:
    """Text inside a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
