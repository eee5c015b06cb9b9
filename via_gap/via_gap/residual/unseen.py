"""What nobody measured, led along what was measured: motors without an encoder, and all that hangs on them.

    led(rows, states, commands, measured, axes, ticks, out)

A motor behind a spring that is pulled along the measured link forgets where it began as fast as its own friction damps
it. Simulated together with a link that is set back to its reading at every segment it need not: each time the spring
is stretched anew, and the error may grow from segment to segment without bound. So the axes that were seen are set to
their readings on every tick, and the same law that the simulator integrates moves the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from via_core.signals import Array
from via_sim.encoders import true_motion
from via_sim.kernel import N_WEIGHTS, advance_tick, begin
from via_sim.parameters import P
from via_sim.torques import N_INPUTS, N_MODES, compiled, laws, settle


@compiled
def led(rows: Array, states: Array, commands: Array, measured: Array, axes: Any, ticks: Any, out: Array) -> None:
    """States (K, n, S) of rows (K, N_PARAMETERS) at ascending ticks (n,) -> out.

    states    (K, S) at tick 0, where they begin; used up
    commands  (K or 1, T, N_COMMANDS) of each row
    measured  (T, 6) angles and velocities as read, of which those of `axes` are known
    """
    u, modes, weights, y = np.zeros(N_INPUTS), np.zeros(N_MODES, np.int64), np.zeros((2, N_WEIGHTS)), np.zeros(9)
    for k in range(len(rows)):
        p, x, sent = rows[k], states[k], commands[k % len(commands)]
        c1, c2 = laws(p)
        begin(p, x, u, modes, weights)
        i = 0
        for n in range(ticks[-1] + 1):
            for axis in axes:
                at = min(n + p[P.skew + axis] / p[P.tick], len(measured) - 1.0)
                low = int(at)
                share, high = at - low, min(low + 1, len(measured) - 1)
                angle = (1.0 - share) * measured[low, axis] + share * measured[high, axis]
                speed = (1.0 - share) * measured[low, 3 + axis] + share * measured[high, 3 + axis]
                x[axis], x[3 + axis] = true_motion(p, axis, angle, speed)
            while i < len(ticks) and ticks[i] == n:
                out[k, i] = x
                i += 1
            if n < ticks[-1]:
                settle(p, c1, c2, x, u, modes)
                advance_tick(p, x, sent[n], u, modes, weights, y)
