"""The demo's one page: the summary and the pictures, as a person would rather see them."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from via_bringup.demo.summary import Summary


def write_page(summary: Summary, path: Path) -> None:
    """Write index.html beside the `pictures` folder it shows."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(files("via_bringup.demo").joinpath("page.html").read_text("utf-8"))
    path.write_text(template.render(s=summary), encoding="utf-8")
