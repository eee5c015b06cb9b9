"""The gap between a simulated and a real joint.

from via_gap import diagnose, frames
report = diagnose({"time": t, "position": q, "torque": tau}, "my_joint.yaml")
frames(report)["causes"]
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from via_gap.api import diagnose, frames

__all__ = ["diagnose", "frames"]


def __getattr__(name: str) -> Any:
    """The functions of `via_gap.api`, imported when they are used: the package itself stays quick to import."""
    if name not in __all__:
        raise AttributeError(f"module 'via_gap' has no attribute '{name}'")
    from via_gap import api

    return getattr(api, name)
