"""Horizontal axes of the charts: quantities, the bins of their values, and numbers rounded to six digits."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from via_core.signals import Array, Mask

from via_gap.candidates.localisation import Quantity

BINS = 10  # of equal count
TIME_BINS = 20  # of equal length
FEWEST = 3  # samples of a bin that is shown


def quantities(states: Array, time: Array, axis: int, n_transmissions: int) -> Mapping[Quantity, tuple[str, Array]]:
    """Unit and values (N,) of the quantities that were measured at every sample.

    states  (N, 6) [rad, rad/s] angles and velocities of link, motor 1, motor 2; NaN: not measured
    time    (N,) [s]
    axis    whose speed and angle are returned: 0 link, 1, 2 motors
    """
    against: dict[Quantity, tuple[str, Array]] = {"speed": ("rad/s", np.abs(states[:, 3 + axis]))}
    if axis > 0 and n_transmissions:
        against["motor angle"] = ("rad", states[:, axis])
    against["angle"] = ("rad", states[:, 0])
    if n_transmissions:
        against["deflection"] = ("rad", states[:, 0] - states[:, min(max(axis, 1), n_transmissions)])
    against["time"] = ("s", time)
    return {by: pair for by, pair in against.items() if np.isfinite(pair[1]).all()}


def bins_of(by: Quantity, values: Array) -> list[tuple[float, float, Mask]]:
    """Range and members (N,) of each bin; bins with fewer than FEWEST samples are left out."""
    if by == "time":
        edges = np.linspace(values.min(), values.max(), TIME_BINS + 1)
    else:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    found = []
    for k, (low, high) in enumerate(pairwise(edges)):
        inside = (values >= low) & ((values < high) if k < len(edges) - 2 else (values <= high))
        if np.sum(inside) >= FEWEST:
            found.append((float(low), float(high), inside))
    return found


def rms(values: Array) -> float:
    """Root mean square, rounded."""
    return six(float(np.sqrt(np.mean(values**2))))


def six(value: float) -> float:
    """Rounded to six digits: more than a chart shows, and short in JSON."""
    return float(f"{value:.6g}")
