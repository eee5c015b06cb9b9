"""Ticks of a joint that `is_smooth`: kernel.py without events, memory, dead time and servos.

Every tick has the bits of `kernel.advance_tick` (test_sim_kernel.py compares them for all devices and effects). It is
short because commands act at once and the number of steps per tick is constant.
"""

from __future__ import annotations

from typing import Any

from via_core.dampers import damper_value
from via_core.signals import Array

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.layout import ARM, DAMPING, EXTERNAL, HISTORY, M1, M2, MODE, QUEUED, U, X
from via_sim.joint.measurements import observe, record
from via_sim.joint.parameters import TORQUE_DRIVE, P
from via_sim.joint.step import PER_AXIS, is_for, stepped, weigh


@bare
def run_smooth(
    p: Array, has: Any, s: Array, x: Array, commands: Array, work: Any, measured: Array, truth: Array
) -> None:  # fmt: skip
    """`kernel.run` of a smooth joint, after `begin`; work: inputs, modes and weights.

    State x is in local variables, and is stored at the end. Its memory of earlier ticks consists of the last ones.
    """
    u, modes, weights = work
    length, every = (x.size - X.queue) // QUEUED, modes[MODE.every]
    forgotten = len(commands) - max(length, HISTORY * every)
    motion, at = (x[0], x[1], x[2], x[3], x[4], x[5]), X.motor_torque
    acted = (x[at], x[at + 1], x[X.damping], x[X.reported_torque], x[X.reported_torque + 1])
    count = modes[MODE.substeps]
    h = p[P.tick] / count
    w = weights[:PER_AXIS], weights[PER_AXIS : 2 * PER_AXIS], weights[2 * PER_AXIS : 3 * PER_AXIS]
    weigh(p, h, 0.0, weights)
    for k in range(len(measured)):
        if k > 0:
            command = commands[k - 1]
            if k > forgotten:
                x[0], x[1], x[2], x[3], x[4], x[5] = motion
                record(x, every)
                now = X.queue + QUEUED * (int(x[X.tick]) % length)
                for i in range(QUEUED):
                    x[now + i] = command[i]
            acted = _supply(p, has, command, u)
            if has.damper is not None and not is_for(weights, h, acted[2]):
                weigh(p, h, acted[2], weights)
            for _ in range(count):
                after = stepped(p, has, x, motion, u, h, modes, w)
                motion = after[:6]
            x[X.tick] += 1.0
            if has.spring is None:  # the torque of a rigid link follows from the state
                x[0], x[3], x[X.damping] = motion[0], motion[3], acted[2]
                x[X.external], x[X.beside] = u[EXTERNAL], u[U.beside]
        observe(p, has, s, x, modes, motion, acted, measured[k], truth[k])
    x[0], x[1], x[2], x[3], x[4], x[5] = motion
    x[at], x[at + 1], x[X.damping], x[X.reported_torque], x[X.reported_torque + 1] = acted
    if len(commands) > 0:
        x[X.external], x[X.beside] = u[EXTERNAL], u[U.beside]
        x[X.lag], x[X.lag + 1], x[X.lag + 2] = commands[-1, EXTERNAL], acted[3], acted[4]


@inlined
def _supply(p: Array, has: Any, command: Array, u: Array) -> Any:
    """Inputs under `command` into u (N_INPUTS,), and what acts (5), see `observe`."""
    u[U.beside] = command[ARM]
    if has.spring is None and p[P.link_drive] == TORQUE_DRIVE:
        u[EXTERNAL] = command[ARM] + (p[P.torque_gain] * command[EXTERNAL] + p[P.torque_bias])
    else:
        u[EXTERNAL] = u[U.beside] = command[ARM] + command[EXTERNAL]
    first = min(max(command[M1], -p[P.torque_limit]), p[P.torque_limit])
    second = min(max(command[M2], -p[P.torque_limit + 1]), p[P.torque_limit + 1])
    torque1 = torque2 = damping = 0.0
    if has.spring is not None:
        torque1 = p[P.torque_gain + 1] * first + p[P.torque_bias + 1]
    if has.second is not None:
        torque2 = p[P.torque_gain + 2] * second + p[P.torque_bias + 2]
    if has.damper is not None:
        damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], command[DAMPING])
    u[M1], u[M2], u[DAMPING] = torque1, torque2, damping
    return torque1, torque2, damping, first, second
