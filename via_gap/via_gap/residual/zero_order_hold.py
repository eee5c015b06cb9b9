"""Means of zero-order-hold commands over the cell of each sample, from halfway before it to halfway after it.

In a trapezoid rule over samples a torque under zero-order hold has the weight of its mean over such a cell:
(u_n + u_{n-1})/2 where commands change on samples, and correct to second order for any dead time, command rate and
jitter.

The means take as long as all other terms of the equations, and most parameter rows of a fit have the same ones.
Therefore the last results are cached.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS, damper_value
from via_core.signals import Array
from via_sim.joint.actuation import saturated
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.torques import DAMPING, EXTERNAL, GOAL, N_COMMANDS, NEIGHBOUR, POWER, bare, compiled

_CACHED = 2  # results: a fit alternates between its parameters and a variation of one of them
# Slots of the row that the means depend on.
_SLOTS = np.concatenate(
    [
        np.arange(first, first + size)
        for first, size in (
            (P.axis_kind, 3), (P.torque_limit, 2), (P.saturation, 3), (P.link_drive, 1), (P.delay, 1),
            (P.damper_site, 1), (P.damper_kind, 1), (P.damper, N_DAMPER_COEFFICIENTS), (P.sensed_gain, 3),
            (P.sensed_bias, 3),
        )
    ]
)  # fmt: skip


class ZeroOrderHold:
    """Commands of a record and their means under a parameter row; arguments as of `Record`."""

    def __init__(self, time: Array, command_time: Array, commands: Array, sensed: bool) -> None:
        self._arguments = time, command_time, commands, sensed
        self._cache: OrderedDict[bytes, tuple[Array, Array]] = OrderedDict()

    def means(self, row: Array) -> tuple[Array, Array]:
        """Means (N, N_COMMANDS) under a parameter row (N_PARAMETERS,): after its dead time, and without dead time."""
        key = row[_SLOTS].tobytes()
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        time, command_time, commands, sensed = self._arguments
        late = np.empty((len(time), N_COMMANDS))
        means_of_cells(row, time, command_time, commands, sensed, row[P.delay], late)
        prompt = late
        if row[P.delay] > 0.0:
            prompt = np.empty_like(late)
            means_of_cells(row, time, command_time, commands, sensed, 0.0, prompt)
        self._cache[key] = late, prompt
        if len(self._cache) > _CACHED:
            self._cache.popitem(last=False)
        return late, prompt


@compiled
def means_of_cells(
    p: Array, time: Array, command_time: Array, commands: Array, sensed: bool, delay: float, out: Array
) -> None:
    """Means over the cells of all samples under a dead time of `delay` [s] into out (N, N_COMMANDS)."""
    last, k = time.size - 1, 0
    for n in range(time.size):
        begin, end = 0.5 * (time[max(n - 1, 0)] + time[n]), 0.5 * (time[n] + time[min(n + 1, last)])
        k = _mean(p, command_time, commands, sensed, k, begin - delay, end - delay, out[n])


@bare
def _driving(p: Array, commands: Array, k: int, column: int, sensed: bool) -> float:
    """Output of the drive under command k: torque [N m], angle [rad] or damping [N m s/rad]."""
    value = commands[k, column]
    if column == DAMPING:
        if p[P.damper_site] == NO_DAMPER:
            return 0.0
        return damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], value)
    if column == EXTERNAL:
        return saturated(p, 0, value) if p[P.link_drive] == TORQUE_DRIVE else value
    if column == GOAL and p[P.link_drive] == POSITION_DRIVE:
        return value * commands[k, POWER]  # zero while off: `_mean_goal` divides by the share of time on
    if column >= NEIGHBOUR or p[P.axis_kind + 1 + column] != DYNAMIC:
        return value
    if sensed:
        value = (value - p[P.sensed_bias + 1 + column]) / p[P.sensed_gain + 1 + column]
    limit = p[P.torque_limit + column]
    return saturated(p, 1 + column, min(max(value, -limit), limit))


@bare
def _mean(
    p: Array, times: Array, commands: Array, sensed: bool, k: int, a: float, b: float, out: Array
) -> int:  # fmt: skip
    """Means over [a, b] [s] into out (N_COMMANDS,); k is a command at or before a, the result one at or before b."""
    last = times.size - 1
    while k < last and times[k + 1] <= a:
        k += 1
    for column in range(out.size):
        out[column] = 0.0
    width = b - a
    while True:
        end = b if k == last else min(times[k + 1], b)
        share = 1.0 if width <= 0.0 else (end - a) / width
        for column in range(out.size):
            out[column] += share * _driving(p, commands, k, column, sensed)
        if k == last or times[k + 1] >= b:
            return k
        a = end
        k += 1
