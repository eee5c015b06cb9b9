"""Compiled simulation of one joint: right-hand side, exponential integrator with events, tick.

Equations (notation.md), for the axes link (M, q), motor 1 and motor 2 (B_i, theta_i), phi_i = q - theta_i:

    M qdd     + (Dq + d) qd + F_q    = tau_ext - sum_i tau_e,i(phi_i) - g(q)
    B_i thdd_i + Dth_i thd_i + F_i   = tau_i + tau_e,i(phi_i)              or closed form of a servo for theta_i

**Choice of the integrator.** The cubic joint of the document has D/B = 12700 1/s at ticks of 1 ms. Explicit methods are
unstable there, and every new command starts a boundary layer of 80 us in the motor speed. The stiff part, however, is
known, linear and diagonal: L = [[0, 1], [0, -a]] per axis with a = viscous friction / inertia. An exponential
Runge-Kutta method integrates it exactly and the other torques to fourth order. The third stage of Krogstad's method
starts from u_n, so it loses less order on stiff problems than Cox and Matthews' (Hochbruck, Ostermann 2010, section
5.4). It needs no Jacobian, linear solve or iteration, and equals the classical method for a = 0. For a torque f,
phi_k(hL) (0, f)' = (h phi_{k+1}(-ha) f, phi_k(-ha) f)', which gives the weights of angles below. The explicit terms
(springs against inertia or viscous friction, coupling dampers, the Stribeck curve) determine the number of substeps,
see `plants.substeps_for`. On the cubic joint (10 s under E1) one step per tick has an error of 2e-6 rad, the three
steps of `substeps_for` 1.3e-7 rad; halving the step reduces the error by 14 to 16.

**Events.** Within its modes (torques.py) the right-hand side is smooth. A step that leaves them is cut at the event,
located to 1e-12 of the step. A stuck axis does not move by one bit. Modes follow from the state at the beginning of a
step: an axis at zero velocity sticks while the torque on it is within breakaway. Elements with memory (bristles,
Maxwell elements, lags) are closed forms of travel or time within a step and are updated at its end.

Source: Krogstad, Generalized integrating factor methods for stiff PDEs, J. Comput. Phys. 203 (2005), scheme ETDRK4-B.
"""

from __future__ import annotations

from collections import namedtuple
from math import ceil, floor, nan
from typing import Any

import numpy as np
from via_core.dampers import damper_value
from via_core.signals import Array
from via_core.springs import N_COEFFICIENTS

from via_sim.joint.actuation import couple, lagged, saturated, servo_motion, supply
from via_sim.joint.encoders import read_motion
from via_sim.joint.friction import viscous_rate
from via_sim.joint.measurements import observe, record, stride
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, SERVO, TORQUE_DRIVE, P
from via_sim.joint.phi_functions import phi_functions
from via_sim.joint.position_drive import acting_goal, drive_torque, followed
from via_sim.joint.torques import (
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
    bare,
    compiled,
    find_modes,
    forced,
    prepare,
    remember,
    spring_coefficients,
    spring_factor,
    violation,
)

# Krogstad's weights of one axis, for velocity and (next column) angle: linear part over half a step and a full step,
# then weights of the torques N(u_n), N(a), N(b), N(c) in stages a, b, c and in the result (N(a) and N(b) share one).
_Weights = namedtuple("_Weights", "half full a_n b_n b_a c_n c_b end_n end_ab end_c")
W: Any = _Weights(*range(0, 20, 2))
PER_AXIS, _FOR = 20, 60  # columns per axis; first of the two columns that hold the step and the damping they are for
N_WEIGHTS = _FOR + 2
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
    torques = forced(p, c1, c2, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
    for i, torque in enumerate(torques):
        out[i] = x[3 + i]
        out[3 + i] = 0.0
        if p[P.axis_kind + i] == DYNAMIC:
            out[3 + i] = torque / p[P.inertia + i] - viscous_rate(p, i, u[DAMPING]) * x[3 + i]


@bare
def weigh(p: Array, h: float, damping: float, weights: Array) -> None:
    """Krogstad's weights for step h [s] into weights (N_WEIGHTS,), see `W`."""
    if weights[_FOR] == h and weights[_FOR + 1] == damping:
        return
    weights[_FOR], weights[_FOR + 1] = h, damping
    for i in range(3):
        w = weights[PER_AXIS * i : PER_AXIS * (i + 1)]
        if p[P.axis_kind + i] != DYNAMIC:
            for j in range(PER_AXIS):
                w[j] = 0.0
            continue
        z = -viscous_rate(p, i, damping) * h
        e, p1, p2, p3, p4 = phi_functions(z)
        eh, h1, h2, h3, _ = phi_functions(0.5 * z)
        w[W.half], w[W.half + 1] = eh, 0.5 * h * h1
        w[W.full], w[W.full + 1] = e, h * p1
        w[W.a_n], w[W.a_n + 1] = 0.5 * h * h1, 0.25 * h * h * h2
        w[W.b_n], w[W.b_n + 1] = h * (0.5 * h1 - h2), 0.5 * h * h * (0.5 * h2 - h3)
        w[W.b_a], w[W.b_a + 1] = h * h2, 0.5 * h * h * h3
        w[W.c_n], w[W.c_n + 1] = h * (p1 - 2.0 * p2), h * h * (p2 - 2.0 * p3)
        w[W.c_b], w[W.c_b + 1] = 2.0 * h * p2, 2.0 * h * h * p3
        w[W.end_n], w[W.end_n + 1] = h * (p1 - 3.0 * p2 + 4.0 * p3), h * h * (p2 - 3.0 * p3 + 4.0 * p4)
        w[W.end_ab], w[W.end_ab + 1] = h * (2.0 * p2 - 4.0 * p3), h * h * (2.0 * p3 - 4.0 * p4)
        w[W.end_c], w[W.end_c + 1] = h * (4.0 * p3 - p2), h * h * (4.0 * p4 - p3)
        for j in range(W.a_n, PER_AXIS):
            w[j] /= p[P.inertia + i]  # N are torques


@bare
def _drift(p: Array, x: Array, u: Array, h: float, axis: int, w: float, w_angle: float) -> tuple[float, float]:
    """Angle and velocity of a motor after h [s] without forced part, or the full motion of a servo."""
    angle, velocity = x[axis] + w_angle * x[3 + axis], w * x[3 + axis]
    if p[P.axis_kind + axis] == SERVO:
        angle, velocity = servo_motion(p, axis - 1, x[axis], x[3 + axis], u[axis - 1], h)
    return angle, velocity


@bare
def _step(p: Array, c1: Array, c2: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array) -> None:
    """One Krogstad step of h [s] in fixed modes from x into y (9,): motion at the end, velocities at the midpoint."""
    weigh(p, h, u[DAMPING], weights)
    w0, w1, w2 = weights[:PER_AXIS], weights[PER_AXIS : 2 * PER_AXIS], weights[2 * PER_AXIS : 3 * PER_AXIS]
    half0, speed0 = x[0] + w0[W.half + 1] * x[3], w0[W.half] * x[3]  # linear part at the midpoint
    half1, speed1 = _drift(p, x, u, 0.5 * h, 1, w1[W.half], w1[W.half + 1])
    half2, speed2 = _drift(p, x, u, 0.5 * h, 2, w2[W.half], w2[W.half + 1])
    full0, end0 = x[0] + w0[W.full + 1] * x[3], w0[W.full] * x[3]  # linear part at the end
    full1, end1 = _drift(p, x, u, h, 1, w1[W.full], w1[W.full + 1])
    full2, end2 = _drift(p, x, u, h, 2, w2[W.full], w2[W.full + 1])
    lags = modes[MODE.lags] != 0
    if lags:
        supply(p, modes, x, u, 0.0)
    n0, n1, n2 = forced(p, c1, c2, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
    v0, v1, v2 = speed0 + w0[W.a_n] * n0, speed1 + w1[W.a_n] * n1, speed2 + w2[W.a_n] * n2
    if lags:
        supply(p, modes, x, u, 0.5 * h)
    a0, a1, a2 = forced(
        p, c1, c2, modes, u, x,
        half0 + w0[W.a_n + 1] * n0, half1 + w1[W.a_n + 1] * n1, half2 + w2[W.a_n + 1] * n2, v0, v1, v2,
    )  # fmt: skip
    r0, r1 = speed0 + w0[W.b_n] * n0 + w0[W.b_a] * a0, speed1 + w1[W.b_n] * n1 + w1[W.b_a] * a1
    r2 = speed2 + w2[W.b_n] * n2 + w2[W.b_a] * a2
    # For torques linear in time the mean of stages a and b is the exact midpoint velocity; each alone errs by O(h^2).
    y[6], y[7], y[8] = 0.5 * (v0 + r0), 0.5 * (v1 + r1), 0.5 * (v2 + r2)
    b0, b1, b2 = forced(
        p, c1, c2, modes, u, x,
        half0 + w0[W.b_n + 1] * n0 + w0[W.b_a + 1] * a0, half1 + w1[W.b_n + 1] * n1 + w1[W.b_a + 1] * a1,
        half2 + w2[W.b_n + 1] * n2 + w2[W.b_a + 1] * a2, r0, r1, r2,
    )  # fmt: skip
    if lags:
        supply(p, modes, x, u, h)
    d0, d1, d2 = forced(
        p, c1, c2, modes, u, x,
        full0 + w0[W.c_n + 1] * n0 + w0[W.c_b + 1] * b0, full1 + w1[W.c_n + 1] * n1 + w1[W.c_b + 1] * b1,
        full2 + w2[W.c_n + 1] * n2 + w2[W.c_b + 1] * b2,
        end0 + w0[W.c_n] * n0 + w0[W.c_b] * b0, end1 + w1[W.c_n] * n1 + w1[W.c_b] * b1,
        end2 + w2[W.c_n] * n2 + w2[W.c_b] * b2,
    )  # fmt: skip
    a0, a1, a2 = a0 + b0, a1 + b1, a2 + b2
    y[0] = full0 + w0[W.end_n + 1] * n0 + w0[W.end_ab + 1] * a0 + w0[W.end_c + 1] * d0
    y[1] = full1 + w1[W.end_n + 1] * n1 + w1[W.end_ab + 1] * a1 + w1[W.end_c + 1] * d1
    y[2] = full2 + w2[W.end_n + 1] * n2 + w2[W.end_ab + 1] * a2 + w2[W.end_c + 1] * d2
    y[3] = end0 + w0[W.end_n] * n0 + w0[W.end_ab] * a0 + w0[W.end_c] * d0
    y[4] = end1 + w1[W.end_n] * n1 + w1[W.end_ab] * a1 + w1[W.end_c] * d1
    y[5] = end2 + w2[W.end_n] * n2 + w2[W.end_ab] * a2 + w2[W.end_c] * d2


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
def _advance(
    p: Array, c1: Array, c2: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array
) -> None:
    """Advance x by h [s] in place with a restart at each event; weights (2, N_WEIGHTS) of full and partial steps."""
    if modes[MODE.switches] == 0:
        _step(p, c1, c2, x, u, h, modes, weights[0], y)
        _accept(p, modes, x, y, u, h)
        return
    left = h
    for event in range(_MAX_EVENTS):
        if modes[MODE.lags] != 0:
            supply(p, modes, x, u, 0.0)
        find_modes(p, c1, c2, x, u, modes)
        high = left
        _step(p, c1, c2, x, u, high, modes, weights[min(event, 1)], y)
        outside = violation(p, c1, c2, x, y, u, modes)
        if outside <= 0.0 and _dips(modes, y):
            _step(p, c1, c2, x, u, 0.5 * left, modes, weights[1], y)
            outside = violation(p, c1, c2, x, y, u, modes)
            if outside > 0.0:
                high = 0.5 * left
            else:
                _step(p, c1, c2, x, u, left, modes, weights[1], y)
        if outside > 0.0:  # Illinois method: within the modes at `low`, outside at `high`
            if modes[MODE.lags] != 0:
                supply(p, modes, x, u, 0.0)
            low, at_low, at_high = 0.0, violation(p, c1, c2, x, x, u, modes), outside
            nearest, last = 0.5 * _EVENT_WIDTH * h, 0
            for trial in range(100):
                if high - low <= _EVENT_WIDTH * h:
                    break
                middle = 0.5 * (low + high)
                if at_low < 0.0 and trial % 8 != 7:
                    middle = low + (high - low) * at_low / (at_low - at_high)
                    middle = min(max(middle, low + nearest), high - nearest)
                _step(p, c1, c2, x, u, middle, modes, weights[1], y)
                outside = violation(p, c1, c2, x, y, u, modes)
                if outside > 0.0:
                    high, at_high = middle, outside
                    at_low *= 0.5 if last > 0 else 1.0  # halve the value of an end that stays twice
                    last = 1
                else:
                    low, at_low = middle, outside
                    at_high *= 0.5 if last < 0 else 1.0
                    last = -1
            _step(p, c1, c2, x, u, high, modes, weights[1], y)
        left -= high
        for i in range(3):
            if abs(modes[i]) == 1 and modes[i] * y[3 + i] <= 0.0:
                y[3 + i] = 0.0  # it stops; `find_modes` decides whether it sticks
        remember(p, modes, x, y)
        _accept(p, modes, x, y, u, high)
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
def advance_tick(p: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array) -> None:
    """Advance state x by one tick under `command` (N_COMMANDS,) in place, with the work memory of `begin`."""
    c1, c2 = p[P.spring : P.spring + N_COEFFICIENTS], p[P.spring + N_COEFFICIENTS : P.spring + 2 * N_COEFFICIENTS]
    record(x, modes[MODE.every])
    tick, length = int(x[X.tick]), (x.size - X.queue) // QUEUED
    now = X.queue + QUEUED * (tick % length)
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
    whole = floor(p[P.delay] / period + 1e-9)
    rest = p[P.delay] - whole * period
    if rest < 1e-9 * period:
        rest = 0.0
    positioned = p[P.link_drive] == POSITION_DRIVE
    if positioned:
        recall_goal(p, x, X.queue + QUEUED * ((tick - whole - 1) % length), u)
    for piece in range(2):  # before and after the command of this tick arrives
        duration = rest if piece == 0 else period - rest
        if duration <= 0.0:
            continue
        queued = X.queue + QUEUED * ((tick - whole - (1 - piece)) % length)
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
        substeps = max(1, ceil(p[P.substeps] * duration / period - 1e-9))
        h = duration / substeps
        for _ in range(substeps):
            _advance(p, c1, c2, x, u, h, modes, weights, y)
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
    c1, c2 = p[P.spring : P.spring + N_COEFFICIENTS], p[P.spring + N_COEFFICIENTS : P.spring + 2 * N_COEFFICIENTS]
    find_modes(p, c1, c2, x, u, modes)


@compiled
def run(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """Advance state x by N ticks under commands (N, N_COMMANDS); store measured (N+1, 9) and truth (N+1, 16)."""
    c1, c2 = spring_coefficients(p)
    u, modes, weights, y = np.zeros(N_INPUTS), np.zeros(N_MODES, np.int64), np.zeros((2, N_WEIGHTS)), np.zeros(9)
    begin(p, x, u, modes, weights)
    observe(p, c1, c2, s, x, measured[0], truth[0])
    for k in range(len(commands)):
        advance_tick(p, x, commands[k], u, modes, weights, y)
        observe(p, c1, c2, s, x, measured[k + 1], truth[k + 1])
