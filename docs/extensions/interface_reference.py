"""Directive `interfaces`: a section for each message, service and action, from the files of via_interfaces."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import blocks
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

FOLDER = Path(__file__).resolve().parents[2] / "via_interfaces"
PARTS = {"msg": ("",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?:=\s*(?P<constant>[^#]*?))?\s*(?:#\s*(?P<text>.*))?")


def setup(app: Any) -> dict[str, bool]:
    """Register the directive with Sphinx."""
    app.add_directive("interfaces", Interfaces)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Interfaces(SphinxDirective):
    """All files of one kind: the argument is msg, srv or action."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections."""
        kind = self.arguments[0]
        files = sorted((FOLDER / kind).glob(f"*.{kind}"))
        self.env.dependencies[self.env.docname].update(str(file) for file in files)
        return [_section(file, kind) for file in files]


def _section(file: Path, kind: str) -> nodes.section:
    first, _, rest = file.read_text(encoding="utf-8").partition("\n")
    name = f"via_interfaces/{kind}/{file.stem}"
    section = blocks.section(name, name)
    section += blocks.text(first.removeprefix("#").strip())
    for title, part in zip(PARTS[kind], rest.split("\n---\n") if "---" in rest else [rest], strict=False):
        rows = fields(part)
        if rows and title:
            section += blocks.text(f"{title}:")
        if rows:
            section += blocks.table(("Field", "Type", "Meaning"), rows)
    return section


def fields(part: str) -> list[tuple[str, str, str]]:
    """Name, type and meaning of each field and constant of one part of an interface file."""
    found = [
        LINE.fullmatch(line.strip()) for line in part.splitlines() if line.strip() and not line.startswith(("#", "---"))
    ]
    return [
        (
            f"`{each['name']}`" + (f" = {each['constant'].strip()}" if each["constant"] else ""),
            f"`{each['type']}`",
            each["text"] or "",
        )
        for each in found
        if each
    ]
