"""What drives a joint over each sample of a record: means of what is held, from halfway before it to halfway after.

Against a trapezoid rule over samples a held torque counts with its mean over such a cell: (u_n + u_{n-1})/2 where
commands change on samples, and right to second order for any dead time, command rate and jitter.

Most parameter rows of a fit differ in nothing that matters here, and these means take as long as all else of the
equations: the last ones are remembered.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS, damper_value
from via_core.signals import Array

from via_sim.actuation import saturated
from via_sim.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.torques import DAMPING, EXTERNAL, GOAL, N_COMMANDS, NEIGHBOUR, POWER, bare, compiled

REMEMBERED = 2  # a fit steps to and fro between its own numbers and one of them moved
# Slots of the row that `_driving` and the dead time take.
_TAKEN = np.concatenate(
    [
        np.arange(first, first + size)
        for first, size in (
            (P.axis_kind, 3), (P.torque_limit, 2), (P.saturation, 3), (P.link_drive, 1), (P.delay, 1),
            (P.damper_site, 1), (P.damper_kind, 1), (P.damper, N_DAMPER_COEFFICIENTS), (P.sensed_gain, 3),
            (P.sensed_bias, 3),
        )
    ]
)  # fmt: skip


class HeldCommands:
    """Commands of a record, and their means as parameter rows have them; see `Record` for the arguments."""

    def __init__(self, time: Array, command_time: Array, commands: Array, sensed: bool) -> None:
        self._arguments = time, command_time, commands, sensed
        self._remembered: OrderedDict[bytes, tuple[Array, Array]] = OrderedDict()

    def means(self, row: Array) -> tuple[Array, Array]:
        """(N, N_COMMANDS) of a parameter row (N_PARAMETERS,): after its dead time, and without it."""
        key = row[_TAKEN].tobytes()
        if key in self._remembered:
            self._remembered.move_to_end(key)
            return self._remembered[key]
        time, command_time, commands, sensed = self._arguments
        late = np.empty((len(time), N_COMMANDS))
        means_of_cells(row, time, command_time, commands, sensed, row[P.delay], late)
        prompt = late
        if row[P.delay] > 0.0:
            prompt = np.empty_like(late)
            means_of_cells(row, time, command_time, commands, sensed, 0.0, prompt)
        self._remembered[key] = late, prompt
        if len(self._remembered) > REMEMBERED:
            self._remembered.popitem(last=False)
        return late, prompt


@compiled
def means_of_cells(
    p: Array, time: Array, command_time: Array, commands: Array, sensed: bool, delay: float, out: Array
) -> None:
    """Means over the cell of every sample, `delay` [s] late -> out (N, N_COMMANDS)."""
    last, k = time.size - 1, 0
    for n in range(time.size):
        begin, end = 0.5 * (time[max(n - 1, 0)] + time[n]), 0.5 * (time[n] + time[min(n + 1, last)])
        k = _means(p, command_time, commands, sensed, k, begin - delay, end - delay, out, n)


@bare
def _driving(p: Array, commands: Array, k: int, column: int, sensed: bool) -> float:
    """What command k asks for once the drive has passed it on: torque [N m], angle [rad] or damping [N m s/rad]."""
    value = commands[k, column]
    if column == DAMPING:
        if p[P.damper_site] == NO_DAMPER:
            return 0.0
        return damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], value)
    if column == EXTERNAL:
        return saturated(p, 0, value) if p[P.link_drive] == TORQUE_DRIVE else value
    if column == GOAL and p[P.link_drive] == POSITION_DRIVE:
        return value * commands[k, POWER]  # only while it is on: over the share of a mean it is, see `equations._aim`
    if column >= NEIGHBOUR or p[P.axis_kind + 1 + column] != DYNAMIC:
        return value
    if sensed:
        value = (value - p[P.sensed_bias + 1 + column]) / p[P.sensed_gain + 1 + column]
    limit = p[P.torque_limit + column]
    return saturated(p, 1 + column, min(max(value, -limit), limit))


@bare
def _means(
    p: Array, times: Array, commands: Array, sensed: bool, k: int, a: float, b: float, out: Array, n: int
) -> int:  # fmt: skip
    """Means over [a, b] [s] of what is held -> out[n]; k: a command not after a, returned: not after b."""
    last = times.size - 1
    while k < last and times[k + 1] <= a:
        k += 1
    for column in range(out.shape[1]):
        out[n, column] = 0.0
    width = b - a
    while True:
        end = b if k == last else min(times[k + 1], b)
        share = 1.0 if width <= 0.0 else (end - a) / width
        for column in range(out.shape[1]):
            out[n, column] += share * _driving(p, commands, k, column, sensed)
        if k == last or times[k + 1] >= b:
            return k
        a = end
        k += 1
