"""States of motors without an encoder at the beginning of each segment.

    motors = UnseenMotors(measured, axes, ticks, commands, start)
    states = motors.states(rows)                                            # (K, n, S)

The friction of a motor behind a spring damps its initial error, provided that the link moves as measured. If the link
were simulated and reset to its measurement at every segment, each reset would change the deflection of the spring
abruptly, and the error could grow without bound. Therefore the measured axes are set to their measurements at every
tick, and the simulator integrates the other axes only.

Torques on the link then have no influence, because the link is reset at the next tick. They are set to zero, and the
link is made so heavy that its velocity stays constant in a tick. Rows that differ only in these torques share their
states.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from via_core.signals import Array, Indices
from via_sim.joint.parameters import P
from via_sim.lockstep.pack import LANES
from via_sim.lockstep.run import lead_many

from via_gap.residual.threads import per_call, together

HEAVY = 1e9  # [kg m^2]
MEMORY = 2**25  # [bytes] of states that are kept
OF_LINK = np.array(  # slots of a row that act on the link alone and have no state: for friction, the slot of the link
    [
        P.inertia, P.viscous_friction, P.viscous_asymmetry, P.quadratic_drag, P.breakaway_friction, P.kinetic_friction,
        P.friction_asymmetry, P.stribeck_velocity, P.load_friction, P.both_sides, P.counter_friction, P.load_stribeck,
        P.counter_stribeck, P.load_quadratic, P.load_velocity, P.gravity_torque, P.gravity_angle, P.gravity, P.coupling,
        P.contact_stiffness, P.contact_damping, P.contact_angle, P.contact_side, P.pulse_torque, P.pulse_start,
        P.pulse_stop,
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class UnseenMotors:
    """States along a measured motion under the recorded commands, with a cache, because many rows are alike.

    measured  (T, 6) angles [rad] and velocities [rad/s], valid for `axes`
    ticks     (n,) ascending: where states are wanted
    commands  (1, T, N_COMMANDS) of the recording
    start     (1, S) state at tick 0, for all rows
    """

    measured: Array
    axes: Indices
    ticks: Indices
    commands: Array
    start: Array
    _found: OrderedDict[bytes, Array] = field(default_factory=OrderedDict, init=False)

    def states(self, rows: Array, aside: Array | None = None) -> Array:
        """States (K, n, S) of rows (K, N_PARAMETERS); `aside` (K, 6) is added to the start of each row."""
        alike, found = rows.copy(), self._found
        alike[:, OF_LINK] = 0.0
        alike[:, P.inertia] = HEAVY
        if aside is not None:
            starts = np.repeat(self.start, len(rows), axis=0)
            starts[:, :6] += aside
            return self.integrated(alike, starts)
        keys = [row.tobytes() for row in alike]
        new = {key: row for key, row in zip(keys, alike, strict=True) if key not in found}
        if new:
            found.update(zip(new, self.integrated(np.stack([*new.values()])), strict=True))
        for key in keys:
            found.move_to_end(key)
        out = np.stack([found[key] for key in keys])
        while len(found) * out[0].nbytes > MEMORY:
            found.popitem(last=False)
        return out

    def integrated(self, rows: Array, starts: Array | None = None, commands: Array | None = None) -> Array:
        """States (K, n, S) of rows (K, N_PARAMETERS), computed on all threads.

        starts    (K, S) of each row, instead of `start`
        commands  (K, T, N_COMMANDS) of each row, instead of the recorded ones
        """
        now = np.repeat(self.start, len(rows), axis=0) if starts is None else starts
        drive = self.commands if commands is None else commands
        out = np.empty((len(rows), len(self.ticks), now.shape[1]))
        calls = []
        size = per_call(len(rows), LANES)
        for part in (slice(first, first + size) for first in range(0, len(rows), size)):
            own = drive if len(drive) == 1 else drive[part]
            calls.append(partial(self._integrate, rows[part], now[part], own, out[part]))
        together(calls)
        return out

    def _integrate(self, rows: Array, states: Array, commands: Array, out: Array) -> None:
        """States of rows -> out (K, n, S); `states` (K, S) at tick 0 are overwritten."""
        runs, length, _ = commands.shape
        sent, under = commands.reshape(runs * length, -1), np.arange(len(rows)) % runs * length
        moved = np.empty((len(rows), int(np.max(np.diff(self.ticks, prepend=0))) + 1, 6))
        now = 0
        for i, tick in enumerate(self.ticks):
            lead_many(rows, states, sent, under + now, self.measured, self.axes, moved[:, : tick - now + 1])
            out[:, i], now = states, tick
