"""Parameters as dataclass fields with all that `via_ros.parameters.declare` needs to make ROS parameters of them."""

from __future__ import annotations

from dataclasses import field
from typing import Any


def parameter(
    default: Any,
    description: str,
    unit: str = "",
    limits: tuple[float, float] | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """A dataclass field with description, unit, inclusive range and choices; what is not given is not declared.

    live  whether the value may change while a node runs
    """
    about = {"description": description, "unit": unit, "range": limits, "choices": choices, "live": live}
    return field(default=default, metadata={key: value for key, value in about.items() if value})
