"""States of motors without an encoder at the beginning of each segment.

    motors = UnseenMotors(MeasuredPath(measured, axes, ticks), commands, start)
    states = motors.states(rows)                                            # (K, n, S)

The friction of a motor behind a spring damps its initial error, provided that the link moves as measured. If the link
were simulated and reset to its measurement at every segment, each reset would interval the spring, and the error could
grow without bound. Therefore the measured axes are set to their measurements at every tick, and the equations of the
simulator integrate the other axes only.

Torques on the link then have no influence, because the link is reset at the next tick. Rows that differ in nothing else
share their states. These torques are set to zero, and the link is so heavy that its velocity stays constant in a tick.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from via_core.signals import Array
from via_sim.joint.parameters import P
from via_sim.lockstep.run import lead_many

from via_gap.residual.threads import THREADS, together

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
class MeasuredPath:
    """Measured motion of one recording, and the ticks at which states are wanted.

    measured  (T, 6) angles [rad] and velocities [rad/s], valid for `axes`
    ticks     (n,) ascending
    """

    measured: Array
    axes: NDArray[np.intp]
    ticks: NDArray[np.intp]

    def states(self, rows: Array, starts: Array, commands: Array) -> Array:
        """States (K, n, S) of rows (K, N_PARAMETERS) from starts (K, S) at tick 0, computed on all threads.

        commands  (1 or K, T, N_COMMANDS) of all rows, or of each
        """
        out = np.empty((len(rows), len(self.ticks), starts.shape[1]))
        calls = []
        for part in np.array_split(np.arange(len(rows)), min(THREADS, len(rows))):
            own = commands if len(commands) == 1 else commands[part]
            calls.append(partial(self._integrate, rows[part], starts[part], own, out[part[0] : part[-1] + 1]))
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


@dataclass(frozen=True, eq=False)
class UnseenMotors:
    """States along a measured path under the recorded commands, with a cache, because many rows are alike.

    commands  (T, N_COMMANDS) of the recording
    start     (S,) state at tick 0, for all rows
    """

    path: MeasuredPath
    commands: Array
    start: Array
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
            states = self.path.states(np.stack([*new.values()]), starts, self.commands[None])
            self.found.update(zip(new, states, strict=True))
        for key in keys:
            self.found.move_to_end(key)
        out = np.stack([self.found[key] for key in keys])
        while len(self.found) * out[0].nbytes > MEMORY:
            self.found.popitem(last=False)
        return out
