"""HTML page of the demo with its summary and pictures."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from via_bringup.demo.summary import Summary


def write_page(summary: Summary, path: Path) -> None:
    """Write the page to `path`, next to the `pictures` folder that it shows."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(files("via_bringup.demo").joinpath("page.html").read_text("utf-8"))
    path.write_text(template.render(s=summary), encoding="utf-8")
