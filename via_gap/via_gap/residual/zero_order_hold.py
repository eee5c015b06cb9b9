"""Means of zero-order-hold commands over the cell of each sample, from halfway before it to halfway after it.

In a trapezoid rule over samples a torque under zero-order hold has the weight of its mean over such a cell:
(u_n + u_{n-1})/2 where commands change on samples, and correct to second order for any dead time, command rate and
jitter.
"""

from __future__ import annotations

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS, damper_value
from via_core.signals import Array
from via_sim.joint.actuation import saturated
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.torques import DAMPING, EXTERNAL, GOAL, NEIGHBOUR, POWER, bare, compiled

SLOTS = np.r_[  # of a row: all that the means depend on
    P.axis_kind : P.axis_kind + 3, P.torque_limit : P.torque_limit + 2, P.saturation : P.saturation + 3, P.link_drive,
    P.delay, P.damper_site, P.damper_kind, P.damper : P.damper + N_DAMPER_COEFFICIENTS,
    P.sensed_gain : P.sensed_gain + 3, P.sensed_bias : P.sensed_bias + 3,
]  # fmt: skip


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
