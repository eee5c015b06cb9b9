"""Motors without an encoder, led along what was measured to the beginning of each segment.

    found = states_along(rows, states, commands, measured, axes, ticks)     # (K, n, S)

A motor behind a spring that is pulled along the measured link forgets where it began as fast as its own friction damps
it. Simulated together with a link that is set back to its reading at every segment it need not: each time the spring
is stretched anew, and the error may grow from segment to segment without bound. So the axes that were seen are set to
their readings on every tick, and the same law that the simulator integrates moves the others.

What acts on the link alone then moves nothing but a link that is set back a tick later: rows that differ in nothing
else share their states. It is left out, and the link so heavy that it keeps within a tick the velocity it was read at.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array
from via_sim.lockstep import lead_many
from via_sim.parameters import P

from via_gap.residual.threads import THREADS, together

HEAVY = 1e9  # [kg m^2]
OF_LINK = np.array(  # slots of a row that act on the link alone and leave nothing in a state: their first is the link's
    [
        P.inertia, P.viscous_friction, P.viscous_asymmetry, P.quadratic_drag, P.breakaway_friction, P.kinetic_friction,
        P.friction_asymmetry, P.stribeck_velocity, P.load_friction, P.both_sides, P.counter_friction, P.load_stribeck,
        P.counter_stribeck, P.load_quadratic, P.load_velocity, P.gravity_torque, P.gravity_angle, P.gravity, P.coupling,
        P.contact_stiffness, P.contact_damping, P.contact_angle, P.contact_side, P.pulse_torque, P.pulse_start,
        P.pulse_stop,
    ]
)  # fmt: skip


def states_along(
    rows: Array, states: Array, commands: Array, measured: Array, axes: NDArray[np.intp], ticks: NDArray[np.intp]
) -> Array:
    """States (K, n, S) of rows (K, N_PARAMETERS) at ascending ticks (n,).

    states    (K, S) at tick 0, the same for rows that differ in the link alone
    commands  (1 or K, T, N_COMMANDS) of all rows, or of each
    measured  (T, 6) angles [rad] and velocities [rad/s] as read, of which those of `axes` are known
    """
    first = which = np.arange(len(rows))
    if len(commands) == 1:
        alike = rows.copy()
        alike[:, OF_LINK] = 0.0
        alike[:, P.inertia] = HEAVY
        _, first, which = np.unique(alike, axis=0, return_index=True, return_inverse=True)
    out = np.empty((len(first), len(ticks), states.shape[1]))
    calls = []
    for part in np.array_split(np.arange(len(first)), min(THREADS, len(first))):
        which_rows, here = first[part], slice(int(part[0]), int(part[-1]) + 1)
        own = commands if len(commands) == 1 else commands[which_rows]
        calls.append(partial(led, rows[which_rows], states[which_rows], own, measured, axes, ticks, out[here]))
    together(calls)
    return out[which.reshape(-1)]


def led(
    rows: Array, states: Array, commands: Array, measured: Array, axes: NDArray[np.intp], ticks: NDArray[np.intp],
    out: Array,
) -> None:  # fmt: skip
    """`states_along` of rows none of which is like another -> out; states (K, S) at tick 0 are used up."""
    runs, length, _ = commands.shape
    sent, under = commands.reshape(runs * length, -1), np.arange(len(rows)) % runs * length
    moved = np.empty((len(rows), int(np.max(np.diff(ticks, prepend=0))) + 1, 6))
    now = 0
    for i, tick in enumerate(ticks):
        lead_many(rows, states, sent, under + now, measured, axes, moved[:, : tick - now + 1])
        out[:, i], now = states, tick
