"""Commands whose modules are imported only when they run, which keeps `via --help` fast."""

from __future__ import annotations

import ast
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True)
class Entry:
    """One command of a table."""

    target: str  # module:attribute, a function or a typer.Typer
    settings: Mapping[str, Any] = field(default_factory=dict)  # context settings of click
    ros2: str = ""  # words of the `ros2` command that runs instead where there is one, e.g. "topic echo"
    text: str = ""  # help line of a typer.Typer

    @property
    def help(self) -> str:
        """Line on the help page of its group: first paragraph of the function's docstring, read without an import."""
        module, _, name = self.target.partition(":")
        return self.text or _first_paragraphs(module)[name]

    def load(self, name: str) -> TyperCommand | TyperGroup:
        """The command. Imports its module."""
        found = resolve_name(self.target)
        if not isinstance(found, typer.Typer):
            app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
            app.command(name, context_settings=dict(self.settings))(found)
            found = app
        return cast(TyperCommand | TyperGroup, typer.main.get_command(found))


@cache
def _first_paragraphs(module: str) -> dict[str, str]:
    """First paragraph of the docstring of each function in the source of a module."""
    spec = find_spec(module)
    source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin else ""
    functions = [each for each in ast.parse(source).body if isinstance(each, ast.FunctionDef)]
    return {each.name: " ".join((ast.get_docstring(each) or "").split("\n\n")[0].split()) for each in functions}


class DeferredCommand(TyperCommand):
    """Placeholder with name and help line, replaced by the loaded command when click runs or completes it."""

    def __init__(self, name: str, entry: Entry) -> None:
        self.entry = entry
        super().__init__(name)

    @property
    def help(self) -> str:
        """The help line, read when a page shows it."""
        return self.entry.help

    @help.setter
    def help(self, text: str | None) -> None:
        """Called by the constructor of click, without a text."""

    def make_context(self, info_name: Any, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the loaded command. click always calls this method before it runs or completes a command."""
        if self.entry.ros2 and not extra.get("resilient_parsing") and (native := shutil.which("ros2")):
            os.execv(native, [native, *self.entry.ros2.split(), *args])
        return self.entry.load(self.name or "").make_context(info_name, args, parent, **extra)


def add(group: TyperGroup, commands: Mapping[str, Entry], helps: Mapping[str, str]) -> None:
    """Add `commands` to `group`. The name "gap diagnose" means the command `diagnose` of the group `gap`.

    helps  help texts of groups, used for those that do not exist yet
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
