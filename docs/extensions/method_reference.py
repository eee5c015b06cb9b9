"""Directives `estimators` and `controllers`: every method with its parameters, from the registries.

`default-methods` is a table of the methods that suit the shipped devices.
"""

from __future__ import annotations

import inspect
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import blocks
import via_core.devices
from docutils import nodes
from sphinx.util.docutils import SphinxDirective
from via_controllers.methods import CONTROLLERS
from via_core.devices import load_device
from via_estimators.methods import METHODS, methods_for


def setup(app: Any) -> dict[str, bool]:
    """Register the directives with Sphinx."""
    app.add_directive("estimators", Estimators)
    app.add_directive("controllers", Controllers)
    app.add_directive("default-methods", DefaultMethods)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Estimators(SphinxDirective):
    """A section for each estimator."""

    def run(self) -> list[nodes.Node]:
        """The sections."""
        return [_section(name, kind.__doc__, get_type_hints(kind)["parameters"]) for name, kind in METHODS.items()]


class Controllers(SphinxDirective):
    """A section for each controller."""

    def run(self) -> list[nodes.Node]:
        """The sections."""
        return [_section(name, kind.__doc__, kind) for name, kind in CONTROLLERS.items()]


class DefaultMethods(SphinxDirective):
    """The shipped devices and the estimators that suit them."""

    def run(self) -> list[nodes.Node]:
        """The table."""
        files = sorted((Path(via_core.devices.__file__).parent / "devices").glob("*.yaml"))
        alike: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
        for device in (load_device(file.stem) for file in files):
            alike.setdefault((device.arrangement, device.drive, methods_for(device)), []).append(f"`{device.name}`")
        rows = []
        for (arrangement, drive, methods), names in sorted(alike.items()):
            suited = [f"`{name}`" for name in methods] or ["none"]
            rows.append((f"{arrangement}, {drive} drive", ", ".join(names), suited[0], ", ".join(suited[1:])))
        return [blocks.table(("Joint", "Shipped devices", "Default", "Also possible"), rows)]


def _section(name: str, docstring: str | None, parameters: Any) -> nodes.section:
    section = blocks.section(name, name)
    section += blocks.text(" ".join(inspect.cleandoc(docstring or "").split("\n\n")[0].split()))
    rows = [_row(each) for each in fields(parameters)]
    section += blocks.table(("Parameter", "Default", "Range", "Meaning"), rows)
    return section


def _row(item: Any) -> tuple[str, str, str, str]:
    about = item.metadata
    low_high = about.get("range")
    unit = about.get("unit", "").replace("-", "")
    allowed = f"{low_high[0]:g} to {low_high[1]:g}" if low_high else ", ".join(about.get("choices", ()))
    default = item.default if item.default != "" else '""'
    return f"`{item.name}`", f"{default} {unit}".strip(), allowed, about.get("description", "")
