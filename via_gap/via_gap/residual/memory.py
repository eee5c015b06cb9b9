"""What elements with memory hold along a measured motion: bristles and Maxwell elements know nothing but angles.

    held = held_along(rows, angles, ticks)      # (K, n, 5)

A segment starts from measured angles; what its elements hold there depends on every reversal since they last slipped,
which may be seconds ago. The same law that the simulator integrates (`remember`) is therefore led along the measured
angles from the beginning of the log on, once per parameter row, instead of being guessed and simulated for a while.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array
from via_sim.parameters import P
from via_sim.torques import N_MODES, X, compiled, remember

HELD = 5  # bristles of link, motor 1, motor 2; Maxwell elements of transmission 1, 2
ELEMENTS = np.concatenate(  # of a row, all that counts here: most rows of a fit differ in other things
    [
        [P.bristle_torque + i for i in range(3)],
        [P.bristle_stiffness + i for i in range(3)],
        [P.hysteresis_torque + i for i in range(2)],
        [P.hysteresis_stiffness + i for i in range(2)],
    ]
)


def held_along(rows: Array, angles: Array, ticks: NDArray[np.intp]) -> Array:
    """Torques [N m] (K, n, HELD) that the elements of rows (K, N_PARAMETERS) hold at ticks (n,).

    angles  (T, 3) [rad] of link and motors on every tick; NaN: not seen, and nothing is known of what hangs on it
    """
    out = np.zeros((len(rows), len(ticks), HELD))
    some = np.flatnonzero(with_memory(rows))
    if some.size and len(ticks):
        order = np.argsort(ticks, kind="stable")
        _, first, which = np.unique(rows[some][:, ELEMENTS], axis=0, return_index=True, return_inverse=True)
        found = np.zeros((first.size, len(ticks), HELD))
        _led(np.ascontiguousarray(rows[some[first]]), angles, np.asarray(ticks)[order], found)
        back = np.empty_like(found)
        back[:, order] = found
        out[some] = back[which.reshape(-1)]
    return out


def with_memory(rows: Array) -> Array:
    """(K,) whether a row has an element with memory."""
    bristles = rows[:, P.bristle_torque : P.bristle_torque + 3] > 0.0
    slips = rows[:, P.hysteresis_torque : P.hysteresis_torque + 2] > 0.0
    return np.asarray(bristles.any(axis=1) | slips.any(axis=1))


@compiled
def _led(rows: Array, angles: Array, ticks: Array, out: Array) -> None:
    """`held_along` for ascending ticks."""
    x, y = np.zeros(X.queue), np.zeros(6)
    modes = np.zeros(N_MODES, np.int64)
    for k in range(len(rows)):
        x[:] = 0.0
        for axis in range(3):
            x[axis] = angles[0, axis] if np.isfinite(angles[0, axis]) else 0.0
        done = 0
        for j in range(len(ticks)):
            while done < ticks[j]:
                done += 1
                for axis in range(3):
                    y[axis] = angles[done, axis] if np.isfinite(angles[done, axis]) else 0.0
                    way = y[axis] - x[axis]
                    modes[axis] = 1 if way > 0.0 else (-1 if way < 0.0 else 0)
                remember(rows[k], modes, x, y)
                for axis in range(3):
                    x[axis] = y[axis]
            for i in range(3):
                out[k, j, i] = x[X.bristle + i]
            for i in range(2):
                out[k, j, 3 + i] = x[X.hysteresis + i]
