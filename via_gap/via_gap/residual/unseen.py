"""Motors without an encoder, led along what was measured to the beginning of each segment.

    along = Along(commands, measured, axes, start, ticks)
    found = along.states(rows)                                              # (K, n, S)

A motor behind a spring that is pulled along the measured link forgets where it began as fast as its own friction damps
it. Simulated together with a link that is set back to its reading at every segment it need not: each time the spring
is stretched anew, and the error may grow from segment to segment without bound. So the axes that were seen are set to
their readings on every tick, and the same law that the simulator integrates moves the others.

What acts on the link alone then moves nothing but a link that is set back a tick later: rows that differ in nothing
else share their states. It is left out, and the link so heavy that it keeps within a tick the velocity it was read at.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array
from via_sim.lockstep.run import lead_many
from via_sim.parameters import P

from via_gap.residual.threads import THREADS, together

HEAVY = 1e9  # [kg m^2]
MEMORY = 2**25  # [bytes] of states that are kept
OF_LINK = np.array(  # slots of a row that act on the link alone and leave nothing in a state: their first is the link's
    [
        P.inertia, P.viscous_friction, P.viscous_asymmetry, P.quadratic_drag, P.breakaway_friction, P.kinetic_friction,
        P.friction_asymmetry, P.stribeck_velocity, P.load_friction, P.both_sides, P.counter_friction, P.load_stribeck,
        P.counter_stribeck, P.load_quadratic, P.load_velocity, P.gravity_torque, P.gravity_angle, P.gravity, P.coupling,
        P.contact_stiffness, P.contact_damping, P.contact_angle, P.contact_side, P.pulse_torque, P.pulse_start,
        P.pulse_stop,
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Along:
    """What one recording leads its motors along, and where they were found; the same question is asked many times.

    commands  (T, N_COMMANDS) of the recording
    measured  (T, 6) angles [rad] and velocities [rad/s] as read, of which those of `axes` are known
    start     (S,) the state at tick 0, for all rows
    ticks     (n,) where states are wanted, ascending
    """

    commands: Array
    measured: Array
    axes: NDArray[np.intp]
    start: Array
    ticks: NDArray[np.intp]
    found: OrderedDict[bytes, Array] = field(default_factory=OrderedDict)

    def states(self, rows: Array) -> Array:
        """States (K, n, S) of rows (K, N_PARAMETERS)."""
        alike = rows.copy()
        alike[:, OF_LINK] = 0.0
        alike[:, P.inertia] = HEAVY
        keys = [row.tobytes() for row in alike]
        new = {key: row for key, row in zip(keys, alike, strict=True) if key not in self.found}
        if new:
            starts = np.repeat(self.start[None], len(new), axis=0)
            self.found.update(zip(new, self._led(np.stack([*new.values()]), starts), strict=True))
        for key in keys:
            self.found.move_to_end(key)
        out = np.stack([self.found[key] for key in keys])
        while len(self.found) * out[0].nbytes > MEMORY:
            self.found.popitem(last=False)
        return out

    def _led(self, rows: Array, starts: Array) -> Array:
        return led_apart(rows, starts, self.commands[None], self.measured, self.axes, self.ticks)


def led_apart(
    rows: Array, starts: Array, commands: Array, measured: Array, axes: NDArray[np.intp], ticks: NDArray[np.intp]
) -> Array:
    """`led` on all threads -> (K, n, S)."""
    out = np.empty((len(rows), len(ticks), starts.shape[1]))
    calls = []
    for part in np.array_split(np.arange(len(rows)), min(THREADS, len(rows))):
        own = commands if len(commands) == 1 else commands[part]
        calls.append(partial(led, rows[part], starts[part], own, measured, axes, ticks, out[part[0] : part[-1] + 1]))
    together(calls)
    return out


def led(
    rows: Array, states: Array, commands: Array, measured: Array, axes: NDArray[np.intp], ticks: NDArray[np.intp],
    out: Array,
) -> None:  # fmt: skip
    """States of rows at ascending ticks -> out (K, n, S); states (K, S) at tick 0 are used up.

    commands  (1 or K, T, N_COMMANDS) of all rows, or of each
    """
    runs, length, _ = commands.shape
    sent, under = commands.reshape(runs * length, -1), np.arange(len(rows)) % runs * length
    moved = np.empty((len(rows), int(np.max(np.diff(ticks, prepend=0))) + 1, 6))
    now = 0
    for i, tick in enumerate(ticks):
        lead_many(rows, states, sent, under + now, measured, axes, moved[:, : tick - now + 1])
        out[:, i], now = states, tick
