"""The step of an encoder, from its measurements."""

from __future__ import annotations

import numpy as np

from via_core.signals import Array

GRID = 0.9  # share of measurements on a common grid from which its step is the quantum
EVEN = 0.9  # share of measurements that advance by one step, beyond which the speed is constant
DISTINCT = 4096  # measurements from which the step is estimated


def step_of(values: Array) -> float:
    """Step [unit of values] of the grid on which measurements lie; 0 if there is no grid.

    At constant speed, measurements of any encoder are evenly spaced, which does not indicate a grid.
    """
    there = values[np.isfinite(values)]
    distinct = np.unique(there[:: max(1, len(there) // DISTINCT)])
    apart = np.diff(distinct)
    apart = apart[apart > 1e-12 * max(float(np.ptp(distinct)) if distinct.size else 0.0, 1e-300)]
    if apart.size < 8:
        return 0.0
    step = float(np.quantile(apart, 0.01))
    for _ in range(3):  # the mean over many steps is more accurate than one step
        counts = np.rint(apart / step)
        near = (counts >= 1.0) & (counts < 50.0)
        if not near.any():
            return 0.0
        step = float(np.sum(apart[near] * counts[near]) / np.sum(counts[near] ** 2))
    if float(np.mean(np.rint(np.abs(np.diff(there)) / step) == 1.0)) > EVEN:
        return 0.0
    off = np.abs((there - there[0]) / step - np.rint((there - there[0]) / step))
    return step if float(np.mean(off < 0.1)) >= GRID else 0.0
