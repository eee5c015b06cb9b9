"""Starts of segments: the measured motion, corrected for the encoder errors of a parameter row."""

from __future__ import annotations

from dataclasses import dataclass

from via_core.signals import Array, Indices
from via_sim.joint.compiled import compiled
from via_sim.joint.encoders import true_motion
from via_sim.joint.parameters import P


@dataclass(frozen=True, eq=False)
class Starts:
    """Where the simulation of each of C segments begins, for other simulators.

    ticks   (C,) at which it begins: some time before the segment if every motor has an encoder, else with it
    states  (C, S) state rows at these ticks
    motion  (C, 6) angles and velocities at the beginning of the segment, valid for the measured axes
    held    (C, HELD) torques of elements with memory there; None: they are simulated
    """

    ticks: Indices
    states: Array
    motion: Array
    held: Array | None


@compiled
def correct(rows: Array, start: Array, ticks: Array, axes: Array, rate: float, found: Array) -> None:
    """Remove skew and encoder errors of rows (n, .) at ticks (n,) of `start` (T, 6) from the axes of `found` (n, 6)."""
    last = len(start) - 1
    for n in range(len(ticks)):
        for axis in axes:
            skew = rows[n, P.skew + axis] * rate
            if skew != 0.0:
                at = min(ticks[n] + skew, float(last))
                low = int(at)
                share, high = at - low, min(low + 1, last)
                for place in (axis, 3 + axis):
                    found[n, place] = (1.0 - share) * start[low, place] + share * start[high, place]
            found[n, axis], found[n, 3 + axis] = true_motion(rows[n], axis, found[n, axis], found[n, 3 + axis])


def without_parts(error: Array, basis: Array, shrink: Array) -> Array:
    """Errors (K, C, r) without the share `shrink` (C, k) of their part along each column of `basis` (C, r, k)."""
    along = shrink[:, :, None] * (basis.swapaxes(1, 2) @ error.transpose(1, 2, 0))  # (C, k, K)
    return error - (basis @ along).transpose(2, 0, 1)
