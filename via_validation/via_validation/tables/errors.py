"""Errors of estimates against the truth, eq. (52) with N = l_fin - l_in + 1 terms (printed: one fewer)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from via_core.errors import SignalError
from via_core.metrics import alike


def mse(truth: ArrayLike, estimate: ArrayLike) -> float:
    """Mean square error, in the unit of the signal squared."""
    a, b = alike(truth=truth, estimate=estimate)
    return float(np.mean((a - b) ** 2))


def msrep(truth: ArrayLike, estimate: ArrayLike) -> float:
    """Mean square relative error in percent: 100 mean(((truth - estimate) / truth)^2) [%].

    Raises SignalError where the truth is 0.
    """
    a, b = alike(truth=truth, estimate=estimate)
    if np.any(a == 0.0):
        raise SignalError(f"'truth' is 0 at sample {int(np.flatnonzero(a == 0.0)[0])}: no relative error")
    return float(100.0 * np.mean(((a - b) / a) ** 2))
