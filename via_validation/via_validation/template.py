"""Pages from Jinja templates of this package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined


def rendered(
    template: str,
    values: Mapping[str, Any],
    filters: Mapping[str, Callable[..., Any]] | None = None,
    escape: bool = False,
) -> str:
    """The text of a template, named by its path in this package, with these values and additional filters.

    Raises jinja2.UndefinedError if the template uses a value that is not given.
    """
    environment = Environment(
        autoescape=escape, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters.update(filters or {})
    text = files("via_validation").joinpath(template).read_text("utf-8")
    return environment.from_string(text).render(**values)


def write_page(
    path: Path, template: str, values: Mapping[str, Any], filters: Mapping[str, Callable[..., Any]] | None = None
) -> None:
    """Write what `rendered` returns; makes the folder if necessary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(rendered(template, values, filters), encoding="utf-8")
