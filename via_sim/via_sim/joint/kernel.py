"""Compiled simulation of one joint: right-hand side, steps with events, tick, run.

Equations (notation.md), for the axes link (M, q), motor 1 and motor 2 (B_i, theta_i), phi_i = q - theta_i:

    M qdd     + (Dq + d) qd + F_q    = tau_ext - sum_i tau_e,i(phi_i) - g(q)
    B_i thdd_i + Dth_i thd_i + F_i   = tau_i + tau_e,i(phi_i)              or closed form of a servo for theta_i

**Events.** Within its modes (torques.py) the right-hand side is smooth. A step that leaves them is cut at the event,
located to 1e-12 of the step. A stuck axis does not move by one bit. Modes follow from the state at the beginning of a
step: an axis at zero velocity sticks while the torque on it is within breakaway. Elements with memory (bristles,
Maxwell elements, lags) are closed forms of travel or time within a step and are updated at its end.
"""

from __future__ import annotations

from math import ceil, floor, nan
from typing import Any

import numpy as np
from via_core.dampers import damper_value
from via_core.signals import Array
from via_core.spring_equations import N_COEFFICIENTS

from via_sim.joint.actuation import couple, lagged, supply
from via_sim.joint.encoders import read_motion
from via_sim.joint.friction import viscous_rate
from via_sim.joint.layout import (
    ARM,
    DAMPING,
    EXTERNAL,
    FULL,
    GOAL,
    MODE,
    N_INPUTS,
    N_MODES,
    NEIGHBOUR,
    POWER,
    QUEUED,
    U,
    X,
)
from via_sim.joint.measurements import observe, record, stride
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, SERVO, TORQUE_DRIVE, P
from via_sim.joint.position_drive import acting_goal, drive_torque, followed
from via_sim.joint.step import N_WEIGHTS, krogstad_step
from via_sim.joint.terms import saturated
from via_sim.joint.torques import (
    bare,
    compiled,
    find_modes,
    forced,
    is_smooth,
    prepare,
    remember,
    seek_modes,
    spring_coefficients,
    spring_factor,
    violation,
)

_MAX_EVENTS = 64  # per substep
_EVENT_WIDTH = 1e-12  # accuracy of the location of an event, relative to a substep


@compiled
def derivative(p: Array, x: Array, u: Array, out: Array) -> None:
    """Right-hand side d/dt (angles, velocities) into out (6,); friction at standstill is set-valued.

    x (X.queue,), u (N_INPUTS,). The acceleration of servo axes is zero here; `servo_motion` is their closed form.
    """
    modes, (c1, c2) = np.zeros(N_MODES, np.int64), spring_coefficients(p)
    prepare(p, modes)
    find_modes(p, c1, c2, x, u, modes)
    torques = forced(p, c1, c2, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5], FULL)
    for i, torque in enumerate(torques):
        out[i] = x[3 + i]
        out[3 + i] = 0.0
        if p[P.axis_kind + i] == DYNAMIC:
            out[3 + i] = torque / p[P.inertia + i] - viscous_rate(p, i, u[DAMPING]) * x[3 + i]


@bare
def _dips(modes: Array, y: Array) -> bool:
    """Whether a slipping axis has the opposite velocity at the midpoint: it reached zero during the step."""
    back = False
    for i in range(3):
        back |= abs(modes[i]) == 1 and modes[i] * y[6 + i] < 0.0
    return back


@bare
def _accept(p: Array, modes: Array, x: Array, y: Array, u: Array, h: float, full: Any) -> None:
    """Set state x to the result y of a step of h [s], and update goal and lags."""
    for i in range(6):
        x[i] = y[i]
    if full is not None:
        if p[P.link_drive] == POSITION_DRIVE:
            u[U.lagged] = acting_goal(p, u[U.target], u[U.followed], u[U.lagged], h)
            u[U.followed] = followed(p, u[U.target], u[U.followed], h)
        elif modes[MODE.lags] != 0:
            for axis in range(3):
                x[X.lag + axis] = lagged(p, axis, x, u, h)


@bare
def _advance(
    p: Array, c1: Array, c2: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array, full: Any
) -> None:
    """Advance x by h [s] in place with a restart at each event; weights (2, N_WEIGHTS) of full and partial steps."""
    if full is None or modes[MODE.switches] == 0:
        krogstad_step(p, c1, c2, x, u, h, modes, weights[0], y, full)
        _accept(p, modes, x, y, u, h, full)
        return
    left = h
    for event in range(_MAX_EVENTS):
        if full is not None and modes[MODE.lags] != 0:
            supply(p, modes, x, u, 0.0)
        seek_modes(p, c1, c2, x, u, modes, full)
        high = left
        krogstad_step(p, c1, c2, x, u, high, modes, weights[min(event, 1)], y, full)
        outside = violation(p, c1, c2, x, y, u, modes, full)
        if outside <= 0.0 and _dips(modes, y):
            krogstad_step(p, c1, c2, x, u, 0.5 * left, modes, weights[1], y, full)
            outside = violation(p, c1, c2, x, y, u, modes, full)
            if outside > 0.0:
                high = 0.5 * left
            else:
                krogstad_step(p, c1, c2, x, u, left, modes, weights[1], y, full)
        if outside > 0.0:  # Illinois method: within the modes at `low`, outside at `high`
            if full is not None and modes[MODE.lags] != 0:
                supply(p, modes, x, u, 0.0)
            low, at_low, at_high = 0.0, violation(p, c1, c2, x, x, u, modes, full), outside
            nearest, last = 0.5 * _EVENT_WIDTH * h, 0
            for trial in range(100):
                if high - low <= _EVENT_WIDTH * h:
                    break
                middle = 0.5 * (low + high)
                if at_low < 0.0 and trial % 8 != 7:
                    middle = low + (high - low) * at_low / (at_low - at_high)
                    middle = min(max(middle, low + nearest), high - nearest)
                krogstad_step(p, c1, c2, x, u, middle, modes, weights[1], y, full)
                outside = violation(p, c1, c2, x, y, u, modes, full)
                if outside > 0.0:
                    high, at_high = middle, outside
                    at_low *= 0.5 if last > 0 else 1.0  # halve the value of an end that stays twice
                    last = 1
                else:
                    low, at_low = middle, outside
                    at_high *= 0.5 if last < 0 else 1.0
                    last = -1
            krogstad_step(p, c1, c2, x, u, high, modes, weights[1], y, full)
        left -= high
        for i in range(3):
            if abs(modes[i]) == 1 and modes[i] * y[3 + i] <= 0.0:
                y[3 + i] = 0.0  # it stops; `find_modes` decides whether it sticks
        if full is not None:
            remember(p, modes, x, y)
        _accept(p, modes, x, y, u, high, full)
        if left <= 0.0:
            return
    for i in range(3):  # too many events: slipping axes rest for the remainder of the substep
        if abs(modes[i]) == 1:
            x[3 + i] = 0.0


@bare
def recall_goal(p: Array, x: Array, last: int, u: Array) -> None:
    """Goal of a position drive at the end of the last tick, whose command is at `last` of x, into u."""
    u[U.followed], _ = read_motion(p, 0, x[0], x[3])  # goal of a drive that was off
    u[U.lagged] = u[U.followed]
    if x[last + POWER] > 0.5:
        u[U.followed] = x[last + GOAL] - x[X.behind]
        u[U.lagged] = u[U.followed] - x[X.lag]


@bare
def take_goal(p: Array, x: Array, queued: int, u: Array) -> None:
    """Command of a position drive, at `queued` of x, into u (N_INPUTS,)."""
    u[U.target], u[U.on] = x[queued + GOAL], 1.0 if x[queued + POWER] > 0.5 else 0.0
    if u[U.on] == 0.0:
        u[U.target], _ = read_motion(p, 0, x[0], x[3])
        u[U.followed] = u[U.lagged] = u[U.target]
    u[U.acting] = u[U.target]


@bare
def queued_at(x: Array, slot: int, late: int) -> int:
    """Index in state x of the command from `late` ticks before the one at `slot` of the queue."""
    turn = slot - late
    return X.queue + QUEUED * (turn if turn >= 0 else turn + (x.size - X.queue) // QUEUED)


@bare
def advance_tick(p: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array) -> None:
    """Advance state x by one tick under `command` (N_COMMANDS,) in place, with the work memory of `begin`."""
    take_tick(p, x, command, u, modes, weights, y, FULL)


@bare
def take_tick(
    p: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array, full: Any
) -> None:  # fmt: skip
    """`advance_tick` in a kernel with or without the rare groups of terms."""
    second = P.spring + N_COEFFICIENTS
    c1, c2 = p[P.spring : P.spring + modes[MODE.coefficients]], p[second : second + modes[MODE.coefficients + 1]]
    record(x, modes[MODE.every])
    tick, length = int(x[X.tick]), (x.size - X.queue) // QUEUED
    slot = tick % length
    now = X.queue + QUEUED * slot
    for i in range(QUEUED):
        x[now + i] = command[i]
    for i in range(2):
        x[X.reported_torque + i] = min(max(command[i], -p[P.torque_limit + i]), p[P.torque_limit + i])
    period = p[P.tick]
    age = p[P.origin] + tick * period
    for i in range(2):
        u[U.spring + i] = spring_factor(p, i, age + 0.5 * period)
    couple(p, command[NEIGHBOUR], command[ARM], u)
    if p[P.link_drive] != TORQUE_DRIVE:
        u[U.beside] += command[EXTERNAL]
    if p[P.pulse_torque] != 0.0:  # mean over the tick
        overlap = min(age + period, p[P.pulse_stop]) - max(age, p[P.pulse_start])
        u[U.beside] += p[P.pulse_torque] * max(overlap, 0.0) / period
    whole = modes[MODE.late]
    rest = p[P.delay] - whole * period
    if rest < 1e-9 * period:
        rest = 0.0
    positioned = False
    if full is not None:
        positioned = p[P.link_drive] == POSITION_DRIVE
    if positioned:
        recall_goal(p, x, queued_at(x, slot, whole + 1), u)
    for piece in range(2):  # before and after the command of this tick arrives
        duration = rest if piece == 0 else period - rest
        if duration <= 0.0:
            continue
        queued = queued_at(x, slot, whole + 1 - piece)
        u[U.target] = saturated(p, 0, x[queued + EXTERNAL])
        for i in range(2):
            limit = p[P.torque_limit + i]
            u[i] = x[queued + i] if p[P.axis_kind + 1 + i] == SERVO else 0.0
            u[U.target + 1 + i] = saturated(p, 1 + i, min(max(x[queued + i], -limit), limit))
        if positioned:
            take_goal(p, x, queued, u)
        supply(p, modes, x, u, 0.0)
        damping = 0.0
        if p[P.damper_site] != NO_DAMPER:
            damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[queued + DAMPING])
        u[DAMPING] = damping + u[U.on] * p[P.drive_damping]
        substeps = modes[MODE.substeps]
        if duration < period:
            substeps = max(1, ceil(p[P.substeps] * duration / period - 1e-9))
        h = duration / substeps
        for _ in range(substeps):
            _advance(p, c1, c2, x, u, h, modes, weights, y, full)
        x[X.damping], x[X.external], x[X.beside] = damping, u[EXTERNAL], u[U.beside]
        for i in range(2):
            x[X.motor_torque + i] = u[i]
        if positioned:
            x[X.external] += drive_torque(p, u[U.acting], u[U.on], x[0])
            x[X.external] -= u[U.on] * p[P.drive_damping] * x[3]
            x[X.behind], x[X.lag] = u[U.target] - u[U.followed], u[U.followed] - u[U.lagged]
        elif modes[MODE.lags] == 0:
            for axis in range(3):
                x[X.lag + axis] = u[U.target + axis]
    x[X.tick] += 1.0


@bare
def begin(p: Array, x: Array, u: Array, modes: Array, weights: Array) -> None:
    """Initialise inputs, modes and weights for a run from state x."""
    weights[:] = nan
    modes[:] = 0
    u[:] = 0.0
    for i in range(2):
        u[U.spring + i] = spring_factor(p, i, p[P.origin])
    prepare(p, modes)
    modes[MODE.every] = stride(p[P.tick])
    modes[MODE.late], modes[MODE.substeps] = floor(p[P.delay] / p[P.tick] + 1e-9), max(1, ceil(p[P.substeps] - 1e-9))
    c1, c2 = p[P.spring : P.spring + N_COEFFICIENTS], p[P.spring + N_COEFFICIENTS : P.spring + 2 * N_COEFFICIENTS]
    find_modes(p, c1, c2, x, u, modes)


@compiled
def run(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """Advance state x by N ticks under commands (N, N_COMMANDS); store measured (N+1, 9) and truth (N+1, 16)."""
    if is_smooth(p, np.zeros(N_MODES, np.int64)):
        run_in(p, s, x, commands, measured, truth, None)
    else:
        run_in(p, s, x, commands, measured, truth, FULL)


@compiled
def run_in(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array, full: Any) -> None:
    """`run` with all terms (FULL), or without the terms that a joint which `is_smooth` lacks (None)."""
    c1, c2 = spring_coefficients(p)
    u, modes, weights, y = np.zeros(N_INPUTS), np.zeros(N_MODES, np.int64), np.zeros((2, N_WEIGHTS)), np.zeros(9)
    begin(p, x, u, modes, weights)
    c1, c2 = c1[: modes[MODE.coefficients]], c2[: modes[MODE.coefficients + 1]]
    observe(p, c1, c2, s, x, measured[0], truth[0], full)
    for k in range(len(commands)):
        take_tick(p, x, commands[k], u, modes, weights, y, full)
        observe(p, c1, c2, s, x, measured[k + 1], truth[k + 1], full)
