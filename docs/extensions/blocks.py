"""Docutils nodes for pages that are made from code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from docutils import nodes


def text(content: str) -> nodes.paragraph:
    """A paragraph; parts between backticks are code."""
    return nodes.paragraph("", "", *inline(content))


def inline(content: str) -> list[nodes.Node]:
    """The text of a paragraph or a table cell; parts between backticks are code."""
    return [
        nodes.literal("", part) if number % 2 else nodes.Text(part)
        for number, part in enumerate(content.split("`"))
        if part
    ]


def code(content: str, language: str = "text") -> nodes.literal_block:
    """A block of code."""
    return nodes.literal_block(content, content, language=language)


def section(title: str, name: str) -> nodes.section:
    """A section whose anchor is made from `name`."""
    return nodes.section(
        "", nodes.title("", title), ids=[nodes.make_id(name)], names=[nodes.fully_normalize_name(name)]
    )


def definitions(entries: Iterable[tuple[str, str]]) -> nodes.definition_list:
    """A list of code terms, each with its text."""
    return nodes.definition_list(
        "",
        *(
            nodes.definition_list_item(
                "", nodes.term("", "", nodes.literal("", term)), nodes.definition("", text(meaning))
            )
            for term, meaning in entries
        ),
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> nodes.table:
    """A table with one line of headings."""
    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in head), cols=len(head))
    group += nodes.thead("", _row(head))
    group += nodes.tbody("", *(_row(row) for row in rows))
    return nodes.table("", group, classes=["colwidths-auto"])


def _row(cells: Sequence[str]) -> nodes.row:
    return nodes.row("", *(nodes.entry("", text(cell)) for cell in cells))
