"""Directive `commands`: a section for each command of `via`, from the commands themselves."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import blocks
import typer
from docutils import nodes
from sphinx.util.docutils import SphinxDirective
from via_bringup.cli import app as via
from via_bringup.cli.deferred import DeferredCommand


def setup(app: Any) -> dict[str, bool]:
    """Register the directive with Sphinx."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Commands(SphinxDirective):
    """All commands, groups after single commands."""

    def run(self) -> list[nodes.Node]:
        """The sections."""
        root = typer.main.get_command(via)
        single = [each for each in commands(root, "via") if each[0].count(" ") == 1]
        grouped = [each for each in commands(root, "via") if each[0].count(" ") > 1]
        return [_section(name, command) for name, command in (*single, *grouped)]


def commands(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Full name and command of all commands of a group, in the order of its help page."""
    for word, command in group.commands.items():
        path = f"{name} {word}"
        if isinstance(command, DeferredCommand):
            command = command.entry.load(word)
        if hasattr(command, "commands"):
            yield from commands(command, path)
        else:
            yield path, command


def _section(name: str, command: Any) -> nodes.section:
    context = command.context_class(command, info_name=name)
    usage = " ".join(command.get_usage(context).removeprefix("Usage:").split())
    section = blocks.section(name, f"command {name}")
    section += blocks.code(usage)
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        lines = [line for line in paragraph.splitlines() if line.strip()]
        if all(line.startswith(" ") for line in lines):
            section += blocks.code("\n".join(lines))
        elif lines:
            section += blocks.text(" ".join(line.strip() for line in lines))
    entries = [_entry(each, context) for each in command.params if not getattr(each, "hidden", False)]
    if entries:
        section += blocks.definitions(entries)
    return section


def _entry(parameter: Any, context: Any) -> tuple[str, str]:
    """An argument or option as on the help page, and its text with the default."""
    record = parameter.get_help_record(context)
    if record is None:
        return parameter.make_metavar(context), ""
    return " ".join(record[0].split()), " ".join(record[1].split()).replace("\\[", "[")  # as rich needs it
