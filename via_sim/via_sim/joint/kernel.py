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

from via_sim.joint.actuation import couple, lagged, supply
from via_sim.joint.compiled import bare, compiled, inlined
from via_sim.joint.encoders import read_motion
from via_sim.joint.friction import viscous_rate
from via_sim.joint.layout import (
    ARM,
    DAMPING,
    EXTERNAL,
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
from via_sim.joint.position_drive import acting_goal, drive_torque, followed, integrated, led
from via_sim.joint.smooth import run_smooth
from via_sim.joint.step import N_WEIGHTS, krogstad_step
from via_sim.joint.structure import EVERYTHING, structure_of
from via_sim.joint.terms import saturated
from via_sim.joint.torques import find_modes, forced, prepare, remember, spring_factor, violation

_MAX_EVENTS, _MAX_TRIALS = 8, 100  # per substep: more are chatter at a jump of a torque; per event
_WHOLE, _MIDPOINT, _LOCATE, _LAST = range(4)  # what a trial step is for
_EVENT_WIDTH = 1e-12  # accuracy of the location of an event, relative to a substep


@compiled
def derivative(p: Array, x: Array, u: Array, out: Array) -> None:
    """Right-hand side d/dt (angles, velocities) into out (6,); friction at standstill is set-valued.

    x (X.queue,), u (N_INPUTS,). The acceleration of servo axes is zero here; `servo_motion` is their closed form.
    """
    modes = np.zeros(N_MODES, np.int64)
    prepare(p, modes)
    find_modes(p, x, u, modes)
    torques = forced(p, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
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
def _accept(p: Array, modes: Array, x: Array, y: Array, u: Array, h: float) -> None:
    """Set state x to the result y of a step of h [s], and update goal and lags."""
    for i in range(6):
        x[i] = y[i]
    if p[P.link_drive] == POSITION_DRIVE:
        u[U.lagged] = acting_goal(p, u[U.target], u[U.followed], u[U.lagged], h)
        u[U.followed] = followed(p, u[U.target], u[U.followed], h)
    elif modes[MODE.lags] != 0:
        for axis in range(3):
            x[X.lag + axis] = lagged(p, axis, x, u, h)


@bare
def _advance(p: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array) -> None:
    """Advance x by h [s] in place with a restart at each event; weights (2, N_WEIGHTS) of full and partial steps."""
    left, switches = h, modes[MODE.switches] != 0
    for event in range(_MAX_EVENTS if switches else 1):
        if switches:
            if modes[MODE.lags] != 0:
                supply(p, EVERYTHING, modes, x, u, 0.0)
            find_modes(p, x, u, modes)
        length, stage, last, trial = left, _WHOLE, 0, 0
        low, high, at_low, at_high = 0.0, left, 0.0, 0.0
        while True:  # one trial step each
            krogstad_step(p, x, u, length, modes, weights[0 if event == 0 and stage == _WHOLE else 1], y)
            if stage == _LAST or not switches:
                break
            outside = violation(p, x, y, u, modes)
            if stage == _LOCATE:  # Illinois method: within the modes at `low`, outside at `high`
                if outside > 0.0:
                    high, at_high = length, outside
                    at_low *= 0.5 if last > 0 else 1.0  # halve the value of an end that stays twice
                    last = 1
                else:
                    low, at_low = length, outside
                    at_high *= 0.5 if last < 0 else 1.0
                    last = -1
            elif outside > 0.0:
                if modes[MODE.lags] != 0:
                    supply(p, EVERYTHING, modes, x, u, 0.0)
                high, at_low, at_high, stage = length, violation(p, x, x, u, modes), outside, _LOCATE
            elif stage == _MIDPOINT:
                length, stage = left, _LAST
                continue
            elif _dips(modes, y):
                length, stage = 0.5 * left, _MIDPOINT
                continue
            else:
                break
            length, stage = high, _LAST
            if high - low > _EVENT_WIDTH * h and trial < _MAX_TRIALS:
                length, stage = 0.5 * (low + high), _LOCATE
                if at_low < 0.0 and trial % 8 != 7:
                    nearest = 0.5 * _EVENT_WIDTH * h
                    length = low + (high - low) * at_low / (at_low - at_high)
                    length = min(max(length, low + nearest), high - nearest)
                trial += 1
        left -= length
        if switches:
            for i in range(3):
                if abs(modes[i]) == 1 and modes[i] * y[3 + i] <= 0.0:
                    y[3 + i] = 0.0  # it stops; `find_modes` decides whether it sticks
            remember(p, modes, x, y)
        _accept(p, modes, x, y, u, length)
        if left <= 0.0:
            return
    for i in range(3):  # too many events: slipping axes rest for the remainder of the substep
        if abs(modes[i]) == 1:
            x[3 + i] = 0.0


@bare
def recall_goal(p: Array, x: Array, last: int, u: Array) -> None:
    """Goal of a position drive at the end of the last tick, whose command is at `last` of x, into u.

    The distance in the state is that from the command itself, without its feedforward.
    """
    u[U.followed], _ = read_motion(p, 0, x[0], x[3])  # goal of a drive that was off
    u[U.lagged] = u[U.followed]
    if x[last + POWER] > 0.5:
        u[U.followed] = x[last + GOAL] - x[X.behind]
        u[U.lagged] = u[U.followed] - x[X.lag]


@bare
def take_goal(p: Array, x: Array, queued: int, before: int, u: Array) -> None:
    """Command of a position drive, at `queued` of x and `before` it, into u (N_INPUTS,)."""
    u[U.target], u[U.on] = x[queued + GOAL], 1.0 if x[queued + POWER] > 0.5 else 0.0
    if x[before + POWER] > 0.5:
        u[U.target] = led(p, u[U.target], x[before + GOAL], p[P.tick])
    if u[U.on] == 0.0:
        u[U.target], _ = read_motion(p, 0, x[0], x[3])
        u[U.followed] = u[U.lagged] = u[U.target]
    u[U.acting] = u[U.target]


@bare
def goal_error(p: Array, x: Array, goal: float) -> float:
    """Distance [rad] of a goal from the measured link angle."""
    measured, _ = read_motion(p, 0, x[0], x[3])
    return goal - measured


@bare
def queued_at(x: Array, slot: int, late: int) -> int:
    """Index in state x of the command from `late` ticks before the one at `slot` of the queue."""
    turn = slot - late
    return X.queue + QUEUED * (turn if turn >= 0 else turn + (x.size - X.queue) // QUEUED)


@bare
def advance_tick(p: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array) -> None:
    """Advance state x by one tick under `command` (N_COMMANDS,) in place, with the work memory of `begin`."""
    _take_tick(p, x, command, u, modes, weights, y)


@inlined
def _take_tick(p: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array) -> None:
    """`advance_tick`, part of its caller."""
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
    positioned, error = p[P.link_drive] == POSITION_DRIVE, 0.0
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
            take_goal(p, x, queued, queued_at(x, slot, whole + 2 - piece), u)
        supply(p, EVERYTHING, modes, x, u, 0.0)
        if positioned:
            error = u[U.on] * goal_error(p, x, u[U.acting])
            x[X.integral] *= u[U.on]
            u[U.held] = integrated(p, x[X.integral], error, 0.5 * duration)
        damping = 0.0
        if p[P.damper_site] != NO_DAMPER:
            damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[queued + DAMPING])
        u[DAMPING] = damping + u[U.on] * p[P.drive_damping]
        substeps = modes[MODE.substeps]
        if duration < period:
            substeps = max(1, ceil(p[P.substeps] * duration / period - 1e-9))
        h = duration / substeps
        for _ in range(substeps):
            _advance(p, x, u, h, modes, weights, y)
        if positioned:
            error = 0.5 * (error + u[U.on] * goal_error(p, x, u[U.lagged]))
            x[X.integral] = integrated(p, x[X.integral], error, duration)
        x[X.damping], x[X.external], x[X.beside] = damping, u[EXTERNAL], u[U.beside]
        for i in range(2):
            x[X.motor_torque + i] = u[i]
        if positioned:
            x[X.external] += drive_torque(p, u[U.acting], u[U.held], u[U.on], x[0], x[3])
            x[X.external] -= u[U.on] * p[P.drive_damping] * x[3]
            sent = x[queued_at(x, slot, whole) + GOAL] if u[U.on] > 0.5 else u[U.target]
            x[X.behind], x[X.lag] = sent - u[U.followed], u[U.followed] - u[U.lagged]
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
    find_modes(p, x, u, modes)


def run(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """Advance state x by N ticks under commands (N, N_COMMANDS); store measured (N+1, 9) and truth (N+1, 16)."""
    run_in(p, structure_of(p, s), s, x, commands, measured, truth)


@compiled
def run_in(p: Array, has: Any, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """`run` of a joint that has this structure."""
    u, modes, weights, y = np.zeros(N_INPUTS), np.zeros(N_MODES, np.int64), np.zeros((2, N_WEIGHTS)), np.zeros(9)
    begin(p, x, u, modes, weights)
    if has.rest is None:
        run_smooth(p, has, s, x, commands, (u, modes, weights[0]), measured, truth)
    else:
        _run_any(p, s, x, commands, (u, modes, weights, y), measured, truth)


@bare
def _run_any(p: Array, s: Array, x: Array, commands: Array, work: Any, measured: Array, truth: Array) -> None:
    u, modes, weights, y = work
    for k in range(len(measured)):
        if k > 0:
            _take_tick(p, x, commands[k - 1], u, modes, weights, y)
        motion, at = (x[0], x[1], x[2], x[3], x[4], x[5]), X.motor_torque
        acted = (x[at], x[at + 1], x[X.damping], x[X.reported_torque], x[X.reported_torque + 1])
        observe(p, EVERYTHING, s, x, modes, motion, acted, measured[k], truth[k])
