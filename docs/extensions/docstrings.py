"""Converts the docstrings of VIA to reStructuredText, which autodoc expects.

The docstrings are plain text: code is between single backticks, aligned columns describe arguments, indented
paragraphs are formulas or code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

ENTRY = re.compile(r"(?P<term>\S+(?:,? \S+)*) {2,}(?P<text>\S.*)")
CODE = re.compile(r"``[^`]+``|`[^`]+`")


def setup(app: Any) -> dict[str, bool]:
    """Register the conversion with Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _skip(_app: Any, _what: str, name: str, _obj: object, skip: bool, _options: object) -> bool | None:
    """Leave out what pydantic adds to every model, and the names by which files select one of several classes."""
    return True if name in ("model_config", "law", "map") else None


def _process(_app: Any, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    lines[:] = [line for paragraph in _paragraphs(lines) for line in (*converted(paragraph), "")]


def _paragraphs(lines: list[str]) -> Iterator[list[str]]:
    return (list(group) for filled, group in groupby(lines, lambda line: line.strip() != "") if filled)


def converted(paragraph: list[str]) -> list[str]:
    """The lines of one paragraph as reStructuredText."""
    if all(line.startswith(" ") for line in paragraph):
        return _literal(paragraph)
    if paragraph[0].startswith("- "):
        return [
            f"- {_inline(line.removeprefix('- '))}" if line.startswith("- ") else f"  {_inline(line.strip())}"
            for line in paragraph
        ]
    out: list[str] = []
    text: list[str] = []
    for line in paragraph:
        entry = ENTRY.fullmatch(line)
        if entry and not line.startswith(" "):
            out += [
                *_text(text),
                *([""] if text else []),
                f"``{entry['term'].strip('`')}``",
                f"   {_inline(entry['text'])}",
            ]
            text = []
        elif out and not text and line.startswith(" "):
            out.append(f"   {_inline(line.strip())}")
        else:
            text.append(line)
    return [*out, *([""] if out and text else []), *_text(text)]


def _text(lines: list[str]) -> list[str]:
    """Running text; lines that are indented below it are a literal block."""
    first = next((k for k, line in enumerate(lines) if line.startswith(" ")), len(lines))
    flat = _inline(" ".join(lines[:first]))
    rest = lines[first:]
    return [*([flat] if flat else []), *(["", *_literal(rest)] if rest else [])]


def _literal(lines: list[str]) -> list[str]:
    return [".. code-block:: text", "", *(f"   {line}" for line in lines)]


def _inline(text: str) -> str:
    """Text with its code marked as such and every other character as written."""
    out, at = [], 0
    for code in CODE.finditer(text):
        out += [_escaped(text[at : code.start()]), f"``{code[0].strip('`')}``"]
        at = code.end()
        if text[at : at + 1].isalnum():
            out.append("\\ ")
    return "".join([*out, _escaped(text[at:])])


def _escaped(text: str) -> str:
    return re.sub(r"([\\*|_])", r"\\\1", text)
