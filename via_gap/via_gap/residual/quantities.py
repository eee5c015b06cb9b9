"""Which kind of motion each segment contains: when, at which angle, how fast, how far, and with which spring load.

A wrong model has different parameters in different kinds of motion, so its parameters are compared between them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from via_core.signals import Array

from via_gap.residual.residual_model import View

AFTER = 1e6  # [s] so much later than a log is the next one


def quantities(views: Sequence[View]) -> dict[str, Array]:
    """(S,) of every segment: when it is, mean angle, distance from the usual angle, speed, and load of each spring."""
    found: dict[str, list[Array]] = {}
    for number, view in enumerate(views):
        segments = view.segments
        ticks = segments.begin[view.chosen][:, None] + np.arange(segments.ticks)
        state = segments.start[np.minimum(ticks, len(segments.start) - 1)]
        angle, usual = state[:, :, 0], np.nanmedian(segments.start[:, 0])
        parts = {
            "time": number * AFTER + ticks[:, 0] / segments.rate,
            "angle": angle.mean(axis=1),
            "amplitude": np.abs(angle - usual).mean(axis=1),
            "speed": np.abs(state[:, :, 3]).mean(axis=1),
        }
        for axis in segments.axes[1:]:
            bent = segments.start[:, 0] - segments.start[:, axis]
            load = np.abs(angle - state[:, :, axis] - np.nanmedian(bent))
            parts[f"load of spring {axis}"] = load.mean(axis=1)
        for name, values in parts.items():
            found.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in found.items()}
