"""Commands that are imported when they run, so that `via --help` and each command load only what they need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True)
class Entry:
    """One command of a table: where its function is, and the line that the help page of its group shows."""

    target: str  # module:attribute, a function or a typer.Typer
    help: str  # first line of the function's docstring
    settings: Mapping[str, Any] = field(default_factory=dict)  # context settings of click

    def load(self, name: str) -> TyperCommand | TyperGroup:
        """The command itself. Imports its module."""
        found = resolve_name(self.target)
        if not isinstance(found, typer.Typer):
            app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
            app.command(name, context_settings=dict(self.settings))(found)
            found = app
        return cast(TyperCommand | TyperGroup, typer.main.get_command(found))


class DeferredCommand(TyperCommand):
    """A command known by name and help line; the context that click makes to run it is that of the loaded command."""

    def __init__(self, name: str, entry: Entry) -> None:
        super().__init__(name, help=entry.help)
        self.entry = entry

    def make_context(self, info_name: Any, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the loaded command; the only method that click calls before it runs or completes a command."""
        return self.entry.load(self.name or "").make_context(info_name, args, parent, **extra)


def add(group: TyperGroup, commands: Mapping[str, Entry], helps: Mapping[str, str]) -> None:
    """Add `commands` to `group`. A name such as "gap blind" is the command blind of the group gap.

    helps  help text of each group that `group` does not have yet
    """
    for path, entry in commands.items():
        *groups, name = path.split()
        into = group
        for each in groups:
            if each not in into.commands:
                into.add_command(TyperGroup(name=each, help=helps[each], no_args_is_help=True))
            found = into.commands[each]
            assert isinstance(found, TyperGroup), path
            into = found
        into.add_command(DeferredCommand(name, entry))
