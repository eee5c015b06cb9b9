"""Simulated motion reduced to what is compared: angles in bins of ticks, and errors without what starts explain."""

from __future__ import annotations

from typing import Any

import numpy as np
from via_core.signals import Array
from via_sim.joint.compiled import compiled


@compiled
def motion_in_bins(moved: Array, axes: Any, every: int, averaged: bool) -> Array:
    """Angles of `axes` (a,) in motion (n, ticks + 1, .) as `segments.binned` of them: (n, b, a)."""
    bins = (moved.shape[1] - 1) // every
    out = np.empty((len(moved), bins, len(axes)))
    for n in range(len(moved)):
        for b in range(bins):
            last = (b + 1) * every
            for a in range(len(axes)):
                if averaged:
                    total = 0.0
                    for tick in range(last - every + 1, last + 1):
                        total += moved[n, tick, axes[a]]
                    out[n, b, a] = total / every
                else:
                    out[n, b, a] = moved[n, last, axes[a]]
    return out


@compiled
def without_parts(error: Array, basis: Array, shrink: Array) -> Array:
    """Errors (K, C, r) without the share `shrink` (C, k) of their part along each column of `basis` (C, r, k)."""
    out = np.empty_like(error)
    count, size, columns = basis.shape
    along = np.empty(columns)
    for row in range(len(error)):
        for c in range(count):
            along[:] = 0.0
            for r in range(size):
                for k in range(columns):
                    along[k] += basis[c, r, k] * error[row, c, r]
            for k in range(columns):
                along[k] *= shrink[c, k]
            for r in range(size):
                part = 0.0
                for k in range(columns):
                    part += basis[c, r, k] * along[k]
                out[row, c, r] = error[row, c, r] - part
    return out
