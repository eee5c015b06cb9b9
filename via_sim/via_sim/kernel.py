"""The one compiled joint: right-hand side, exponential integrator with events, tick.

Equations (notation.md), for the axes link (M, q), motor 1 and motor 2 (B_i, theta_i), phi_i = q - theta_i:

    M qdd     + (Dq + d) qd + F_q    = tau_ext - sum_i tau_e,i(phi_i) - g(q)
    B_i thdd_i + Dth_i thd_i + F_i   = tau_i + tau_e,i(phi_i)              or theta_i follows its servo in closed form

**Why this integrator.** The document's cubic joint has D/B = 12700 1/s under a 1 ms tick: explicit methods are unstable,
and every held command starts a boundary layer of 80 us in the motor's speed. But the stiff part is known, linear and
diagonal: L = [[0, 1], [0, -a]] per axis, a = viscous friction / inertia. An exponential Runge-Kutta method integrates it
exactly and the rest to fourth order: Krogstad's, whose third stage starts from u_n and not from another stage, so that it
loses less order on stiff problems than Cox and Matthews' (Hochbruck, Ostermann 2010, section 5.4). No Jacobian, no
linear solve, no iteration, and with a = 0 it is the classical method. Applied to a torque, phi_k(hL) (0, f)' is
(h phi_{k+1}(-ha) f, phi_k(-ha) f)', hence the position weights below. What stays explicit (springs against inertia or
viscous friction, coupling dampers, the Stribeck curve) sets the number of substeps; see `plants.substeps_for`.

**Dry friction and backlash are sets, not smoothed signs.** Within a step each axis either slips one way (friction
constant in sign) or is stuck (acceleration zero, friction takes whatever it must), and each transmission is in its gap
or on one flank; so the right-hand side is smooth. A step that leaves its mode is cut at the event, located to 1e-12 of
the step. A stuck axis does not move by one bit. Modes follow from the state at the start of a step: at speed zero an
axis is stuck exactly while |torque| <= breakaway. Source: Piiroinen, Kuznetsov, An event-driven method to simulate
Filippov systems, ACM TOMS 34 (2008); the exponential scheme: Krogstad, Generalized integrating factor methods, J. Comput.
Phys. 203 (2005), eq. (51).
"""

from __future__ import annotations

from collections import namedtuple
from math import ceil, copysign, cos, exp, floor, inf, log, nan, pi, sin, sqrt

import numpy as np
from numba import njit

from via_core.dampers import damper_value
from via_core.servos import servo_step
from via_core.signals import Array
from via_core.springs import MACCEPA, N_COEFFICIENTS, spring_stiffness, spring_torque
from via_sim.parameters import AT_TRANSMISSION, DYNAMIC, MOTOR_2, NO_DAMPER, SERVO, P
from via_sim.phi_functions import phi_functions

# State row: positions and velocities of the three axes, then what was last applied, then the queue of commands.
State = namedtuple("State", "position velocity tick seed reported_torque motor_torque damping queue")
X = State(0, 3, 6, 7, 8, 10, 12, 13)
QUEUED = 3  # columns of the queue: motor 1, motor 2, damping command

# Command row, held over a tick: motor 1, motor 2 [N m or rad], damping [-], external torque at the link [N m].
N_COMMANDS = 4
M1, M2, DAMPING, EXTERNAL = range(N_COMMANDS)

# Measured row and truth row of one tick.
MEASURED = (
    "q", "theta_1", "theta_2", "tau_1", "tau_2", "q_velocity", "theta_velocity_1", "theta_velocity_2", "tau_link",
)  # fmt: skip
TRUTH = (
    "q", "theta_1", "theta_2", "q_velocity", "theta_velocity_1", "theta_velocity_2", "stiffness", "stiffness_1",
    "stiffness_2", "damping", "deflection_1", "deflection_2", "motor_torque_1", "motor_torque_2", "transmission_torque_1",
    "transmission_torque_2",
)  # fmt: skip

# Sensor row; a noise of NaN means 'not measured', a quantum of 0 'not quantised'.
SensorSlots = namedtuple(
    "SensorSlots", "link_quantum motor_quantum link_noise motor_noise velocity_noise torque_noise link_torque_noise"
)
S = SensorSlots(*range(7))

_STUCK, _SMOOTH = 0, 2  # besides slip directions -1 and +1: no dry friction on this axis
_N_WEIGHTS = 20
_MAX_EVENTS = 64  # per substep
_compiled = njit(cache=True, error_model="numpy", nogil=True)


@_compiled
def transmission_torque(p: Array, springs: Array, i: int, phi: float, preset: float, flank: int) -> float:
    """tau_e,i [N m] at deflection phi; `flank` is 0 inside the backlash gap, else its side -1 or +1."""
    gap = p[P.backlash + i]
    if gap > 0.0:
        if flank == 0:
            return 0.0
        phi -= flank * 0.5 * gap
    kind, stop = int(p[P.spring_kind + i]), p[P.stop + i]
    if kind < MACCEPA and abs(phi) > stop:  # these laws explode or end beyond their stop
        return copysign(p[P.stop_torque + i] + p[P.stop_slope + i] * (abs(phi) - stop), phi)
    return spring_torque(kind, springs[i], phi, preset)


@_compiled
def transmission_stiffness(p: Array, springs: Array, i: int, phi: float, preset: float) -> float:
    """sigma_i [N m/rad] at deflection phi."""
    gap = p[P.backlash + i]
    if gap > 0.0:
        if abs(phi) < 0.5 * gap:
            return 0.0
        phi -= copysign(0.5 * gap, phi)
    kind, stop = int(p[P.spring_kind + i]), p[P.stop + i]
    if kind < MACCEPA and abs(phi) > stop:
        return p[P.stop_slope + i]
    return spring_stiffness(kind, springs[i], phi, preset)


@_compiled
def _preset(p: Array, x: Array, i: int) -> float:
    """The preset [rad] that spring i sees: motor 2 of a serial joint, else its own motor."""
    return x[MOTOR_2] if p[P.serial] != 0.0 else x[1 + i]


@_compiled
def motive_torques(p: Array, springs: Array, x: Array, u: Array, flanks: Array, out: Array) -> None:
    """Torque on each axis but for its own viscous and dry friction -> out (3,) [N m].

    x (6,) positions and velocities; u (4,) torques of the motors, damping [N m s/rad], external torque.
    """
    link = u[EXTERNAL] - p[P.gravity_torque] * sin(x[0] - p[P.gravity_angle])
    out[1], out[2] = u[M1], u[M2]
    for i in range(int(p[P.transmissions])):
        torque = transmission_torque(p, springs, i, x[0] - x[1 + i], _preset(p, x, i), flanks[i])
        link -= torque
        out[1 + i] += torque
    if p[P.damper_site] == AT_TRANSMISSION:  # of transmission 1; the diagonal part is in `viscous_rate`
        link += u[DAMPING] * x[4]
        out[1] += u[DAMPING] * x[3]
    out[0] = link


@_compiled
def viscous_rate(p: Array, axis: int, damping: float) -> float:
    """a = viscous friction / inertia [1/s] of an axis, damper included."""
    site, viscous = p[P.damper_site], p[P.viscous_friction + axis]
    if (axis == 0 and site != NO_DAMPER) or (axis == 1 and site == AT_TRANSMISSION):
        viscous += damping
    return viscous / p[P.inertia + axis]


@_compiled
def dry_friction(p: Array, axis: int, speed: float) -> float:
    """Magnitude [N m] of the friction on an axis that slips with speed >= 0 (Stribeck curve)."""
    kinetic = p[P.kinetic_friction + axis]
    excess = p[P.breakaway_friction + axis] - kinetic
    if excess == 0.0:
        return kinetic
    ratio = speed / p[P.stribeck_velocity + axis]
    return kinetic + excess * exp(-ratio * ratio)


@_compiled
def settle(p: Array, springs: Array, x: Array, u: Array, slips: Array, flanks: Array, torque: Array) -> bool:
    """The modes that state x is in -> slips (3,), flanks (2,); True where there is any dry friction or backlash."""
    switches = False
    for i in range(int(p[P.transmissions])):
        half = 0.5 * p[P.backlash + i]
        phi = x[0] - x[1 + i]
        flanks[i] = 0 if abs(phi) < half else (1 if phi > 0.0 else -1)
        switches |= half > 0.0
    motive_torques(p, springs, x, u, flanks, torque)
    for i in range(3):
        slips[i] = _SMOOTH
        breakaway = p[P.breakaway_friction + i]
        if breakaway > 0.0 and p[P.axis_kind + i] == DYNAMIC:
            switches = True
            drive = x[3 + i] if x[3 + i] != 0.0 else torque[i]
            slips[i] = 1 if drive > 0.0 else -1
            if x[3 + i] == 0.0 and abs(torque[i]) <= breakaway:
                slips[i] = _STUCK
    return switches


@_compiled
def _forced(
    p: Array, springs: Array, x: Array, u: Array, slips: Array, flanks: Array, torque: Array, out: Array
) -> None:
    """The part of each acceleration that the exponential does not cover -> out (3,) [rad/s^2]."""
    motive_torques(p, springs, x, u, flanks, torque)
    for i in range(3):
        side = slips[i]
        if side == _STUCK:
            out[i] = 0.0
        elif side == _SMOOTH:
            out[i] = torque[i] / p[P.inertia + i]
        else:
            out[i] = (torque[i] - side * dry_friction(p, i, side * x[3 + i])) / p[P.inertia + i]


@_compiled
def derivative(p: Array, springs: Array, x: Array, u: Array, out: Array) -> None:
    """The right-hand side: d/dt (positions, velocities) -> out (6,), friction resolved as a set at standstill.

    Servo axes move with their own velocity and report zero acceleration: their closed form is in `servo_step`.
    """
    slips, flanks, torque, acceleration = np.empty(3, np.int64), np.zeros(2, np.int64), np.empty(3), np.empty(3)
    settle(p, springs, x, u, slips, flanks, torque)
    _forced(p, springs, x, u, slips, flanks, torque, acceleration)
    for i in range(3):
        moves = p[P.axis_kind + i] == DYNAMIC
        out[i] = x[3 + i]
        out[3 + i] = acceleration[i] - viscous_rate(p, i, u[DAMPING]) * x[3 + i] if moves else 0.0


@_compiled
def _weigh(p: Array, h: float, damping: float, weights: Array, key: Array) -> None:
    """Krogstad's weights of every axis for step h -> weights (3, 20); `key` (2,) remembers for which they are."""
    if key[0] == h and key[1] == damping:
        return
    key[0], key[1] = h, damping
    for i in range(3):
        z = -viscous_rate(p, i, damping) * h
        e, p1, p2, p3, p4 = phi_functions(z)
        eh, h1, h2, h3, _ = phi_functions(0.5 * z)
        w = weights[i]
        w[0], w[1] = eh, 0.5 * h * h1  # half a step of the linear part: velocity, position
        w[2], w[3] = e, h * p1  # a whole step
        w[4], w[5] = 0.5 * h * h1, 0.25 * h * h * h2  # stage a: velocity, position weights of N(u)
        w[6], w[7] = h * (0.5 * h1 - h2), 0.5 * h * h * (0.5 * h2 - h3)  # stage b: of N(u)
        w[8], w[9] = h * h2, 0.5 * h * h * h3  # stage b: of N(a)
        w[10], w[11] = h * (p1 - 2.0 * p2), h * h * (p2 - 2.0 * p3)  # stage c: of N(u)
        w[12], w[13] = 2.0 * h * p2, 2.0 * h * h * p3  # stage c: of N(b)
        w[14], w[15] = h * (p1 - 3.0 * p2 + 4.0 * p3), h * h * (p2 - 3.0 * p3 + 4.0 * p4)  # result: of N(u)
        w[16], w[17] = h * (2.0 * p2 - 4.0 * p3), h * h * (2.0 * p3 - 4.0 * p4)  # of N(a) + N(b)
        w[18], w[19] = h * (4.0 * p3 - p2), h * h * (4.0 * p4 - p3)  # of N(c)


@_compiled
def _step(
    p: Array, springs: Array, x: Array, u: Array, h: float, slips: Array, flanks: Array,
    weights: Array, key: Array, stage: Array, n: Array, torque: Array, y: Array,
) -> None:  # fmt: skip
    """One Krogstad step of h [s] in fixed modes: x (6,) -> y (6,). Leaves stage b (midpoint) velocities in n[4]."""
    _weigh(p, h, u[DAMPING], weights, key)
    for i in range(3):  # axes without dynamics take their place at the midpoint, at stages a and b alike
        if p[P.axis_kind + i] == SERVO:
            stage[i], stage[3 + i] = servo_step(x[i], x[3 + i], u[i - 1], p[P.bandwidth + i - 1], 0.5 * h)
        elif p[P.axis_kind + i] != DYNAMIC:
            stage[i], stage[3 + i] = x[i], 0.0
    _forced(p, springs, x, u, slips, flanks, torque, n[0])
    for i in range(3):
        if p[P.axis_kind + i] == DYNAMIC:
            w = weights[i]
            stage[i] = x[i] + w[1] * x[3 + i] + w[5] * n[0, i]
            stage[3 + i] = w[0] * x[3 + i] + w[4] * n[0, i]
    _forced(p, springs, stage, u, slips, flanks, torque, n[1])
    for i in range(3):
        if p[P.axis_kind + i] == DYNAMIC:
            w = weights[i]
            stage[i] = x[i] + w[1] * x[3 + i] + w[7] * n[0, i] + w[9] * n[1, i]
            stage[3 + i] = w[0] * x[3 + i] + w[6] * n[0, i] + w[8] * n[1, i]
        n[4, i] = stage[3 + i]
    _forced(p, springs, stage, u, slips, flanks, torque, n[2])
    for i in range(3):
        if p[P.axis_kind + i] == DYNAMIC:
            w = weights[i]
            stage[i] = x[i] + w[3] * x[3 + i] + w[11] * n[0, i] + w[13] * n[2, i]
            stage[3 + i] = w[2] * x[3 + i] + w[10] * n[0, i] + w[12] * n[2, i]
        elif p[P.axis_kind + i] == SERVO:
            stage[i], stage[3 + i] = servo_step(x[i], x[3 + i], u[i - 1], p[P.bandwidth + i - 1], h)
    _forced(p, springs, stage, u, slips, flanks, torque, n[3])
    for i in range(3):
        if p[P.axis_kind + i] == DYNAMIC:
            w = weights[i]
            middle = n[1, i] + n[2, i]
            y[i] = x[i] + w[3] * x[3 + i] + w[15] * n[0, i] + w[17] * middle + w[19] * n[3, i]
            y[3 + i] = w[2] * x[3 + i] + w[14] * n[0, i] + w[16] * middle + w[18] * n[3, i]
        else:
            y[i], y[3 + i] = stage[i], stage[3 + i]


@_compiled
def _violation(p: Array, springs: Array, y: Array, u: Array, slips: Array, flanks: Array, torque: Array) -> float:
    """How far state y lies outside the modes it was reached in; <= 0 inside. Continuous along a trajectory."""
    worst = -inf
    motive_torques(p, springs, y, u, flanks, torque)
    for i in range(3):
        if slips[i] == _STUCK:
            worst = max(worst, abs(torque[i]) - p[P.breakaway_friction + i])
        elif slips[i] != _SMOOTH:
            worst = max(worst, -slips[i] * y[3 + i])
    for i in range(int(p[P.transmissions])):
        half = 0.5 * p[P.backlash + i]
        if half > 0.0:
            phi = y[0] - y[1 + i]
            worst = max(worst, abs(phi) - half if flanks[i] == 0 else half - flanks[i] * phi)
    return worst


@_compiled
def _advance(
    p: Array, springs: Array, x: Array, u: Array, h: float, slips: Array, flanks: Array,
    weights: Array, key: Array, event_weights: Array, event_key: Array, stage: Array, n: Array, torque: Array, y: Array,
) -> None:  # fmt: skip
    """x (6,) moves on by h [s] in place, cut at every event."""
    switches = settle(p, springs, x, u, slips, flanks, torque)
    if not switches:
        _step(p, springs, x, u, h, slips, flanks, weights, key, stage, n, torque, y)
        x[:6] = y
        return
    left = h
    for event in range(_MAX_EVENTS):
        if event == 0:
            _step(p, springs, x, u, left, slips, flanks, weights, key, stage, n, torque, y)
        else:
            _step(p, springs, x, u, left, slips, flanks, event_weights, event_key, stage, n, torque, y)
        out_of_mode = _violation(p, springs, y, u, slips, flanks, torque)
        high = left
        if out_of_mode <= 0.0:
            dips = False  # a speed that touches zero and returns within the step
            for i in range(3):
                dips |= abs(slips[i]) == 1 and slips[i] * n[4, i] < 0.0
            if dips:
                high = 0.5 * left
                _step(p, springs, x, u, high, slips, flanks, event_weights, event_key, stage, n, torque, y)
                out_of_mode = _violation(p, springs, y, u, slips, flanks, torque)
                if out_of_mode <= 0.0:
                    _step(p, springs, x, u, left, slips, flanks, event_weights, event_key, stage, n, torque, y)
            if out_of_mode <= 0.0:
                x[:6] = y
                return
        # Illinois: the modes hold at `low`, no longer at `high`; y is the state at `high`
        low, at_low = 0.0, _violation(p, springs, x, u, slips, flanks, torque)
        at_high = out_of_mode
        for trial in range(80):
            if high - low <= 1e-12 * h:
                break
            share = at_low / (at_low - at_high) if at_low < 0.0 and trial % 4 != 3 else 0.5
            middle = low + (high - low) * min(max(share, 1e-9), 1.0 - 1e-9)
            _step(p, springs, x, u, middle, slips, flanks, event_weights, event_key, stage, n, torque, y)
            out_of_mode = _violation(p, springs, y, u, slips, flanks, torque)
            if out_of_mode > 0.0:
                high, at_high, at_low = middle, out_of_mode, 0.5 * at_low
            else:
                low, at_low, at_high = middle, out_of_mode, 0.5 * at_high
        _step(p, springs, x, u, high, slips, flanks, event_weights, event_key, stage, n, torque, y)
        left -= high
        for i in range(3):
            if abs(slips[i]) == 1 and slips[i] * y[3 + i] <= 0.0:
                y[3 + i] = 0.0  # it stops; `settle` decides whether it stays
        x[:6] = y
        if left <= 0.0:
            return
        settle(p, springs, x, u, slips, flanks, torque)
    for i in range(3):  # chattering beyond all measure: rest for what is left of this substep
        if abs(slips[i]) == 1:
            x[3 + i] = 0.0


@_compiled
def _tick(
    p: Array, springs: Array, x: Array, command: Array, u: Array, slips: Array, flanks: Array,
    weights: Array, key: Array, event_weights: Array, event_key: Array, stage: Array, n: Array, torque: Array, y: Array,
) -> None:  # fmt: skip
    """State x lives through one tick under `command` (4,), in place."""
    tick, length = int(x[X.tick]), (x.size - X.queue) // QUEUED
    now = X.queue + QUEUED * (tick % length)
    for i in range(QUEUED):
        x[now + i] = command[i]
    for i in range(2):
        x[X.reported_torque + i] = min(max(command[i], -p[P.torque_limit + i]), p[P.torque_limit + i])
    period = p[P.tick]
    whole = int(floor(p[P.delay] / period + 1e-9))
    rest = p[P.delay] - whole * period
    if rest < 1e-9 * period:
        rest = 0.0
    for piece in range(2):
        duration = rest if piece == 0 else period - rest
        if duration <= 0.0:
            continue
        held = X.queue + QUEUED * ((tick - whole - (1 if piece == 0 else 0)) % length)
        for i in range(2):
            limit = p[P.torque_limit + i]
            if p[P.axis_kind + 1 + i] == SERVO:
                u[i] = x[held + i]
            else:
                u[i] = p[P.torque_gain + i] * min(max(x[held + i], -limit), limit)
            x[X.motor_torque + i] = u[i]
        u[DAMPING] = 0.0
        if p[P.damper_site] != NO_DAMPER:
            u[DAMPING] = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[held + DAMPING])
        x[X.damping] = u[DAMPING]
        u[EXTERNAL] = command[EXTERNAL]
        substeps = max(1, int(ceil(p[P.substeps] * duration / period - 1e-9)))
        h = duration / substeps
        for _ in range(substeps):
            _advance(
                p, springs, x, u, h, slips, flanks, weights, key, event_weights, event_key, stage, n, torque, y
            )  # fmt: skip
    x[X.tick] += 1.0


@_compiled
def _uniform(seed: np.uint64, tick: np.uint64, channel: np.uint64) -> float:
    """A uniform number in (0, 1) that is a pure function of its three counters (splitmix64 finaliser, twice)."""
    z = seed * np.uint64(0xD1342543DE82EF95) + tick * np.uint64(32) + channel
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (float(z >> np.uint64(11)) + 0.5) / 9007199254740992.0


@_compiled
def noise(x: Array, channel: int) -> float:
    """A standard normal number for this channel at this tick: Box-Muller on counters, no hidden state."""
    seed, tick = np.uint64(x[X.seed]), np.uint64(x[X.tick])
    one = _uniform(seed, tick, np.uint64(2 * channel))
    two = _uniform(seed, tick, np.uint64(2 * channel + 1))
    return sqrt(-2.0 * log(one)) * cos(2.0 * pi * two)


@_compiled
def _read(true: float, deviation: float, quantum: float, x: Array, channel: int) -> float:
    """A sensor: noise first, then the quantiser, as in an encoder."""
    value = true
    if deviation != 0.0:
        value += deviation * noise(x, channel)
    return quantum * np.rint(value / quantum) if quantum > 0.0 else value


@_compiled
def observe(p: Array, springs: Array, s: Array, x: Array, measured: Array, truth: Array) -> None:
    """What sensors s read of state x -> measured (9,), and what is -> truth (16,). NaN: no such axis or no sensor."""
    transmissions = int(p[P.transmissions])
    for i in range(6):
        truth[i] = x[i] if p[P.axis_kind + i % 3] != 0.0 else nan
    truth[6], truth[9] = 0.0, x[X.damping]
    for i in range(2):
        truth[7 + i] = truth[10 + i] = truth[14 + i] = nan
        motored = p[P.axis_kind + 1 + i]
        truth[12 + i] = x[X.motor_torque + i] if motored == DYNAMIC else nan
        measured[3 + i] = nan
        if motored == DYNAMIC:
            measured[3 + i] = _read(x[X.reported_torque + i], s[S.torque_noise], 0.0, x, 3 + i)
    link_torque = 0.0
    for i in range(transmissions):
        phi, preset = x[0] - x[1 + i], _preset(p, x, i)
        flank = 0 if abs(phi) < 0.5 * p[P.backlash + i] else (1 if phi > 0.0 else -1)
        truth[7 + i] = transmission_stiffness(p, springs, i, phi, preset)
        truth[6] += truth[7 + i]
        truth[10 + i] = phi
        truth[14 + i] = transmission_torque(p, springs, i, phi, preset, flank)
        link_torque += truth[14 + i]
    for i in range(3):
        there = p[P.axis_kind + i] != 0.0
        quantum, deviation = (s[S.link_quantum], s[S.link_noise]) if i == 0 else (s[S.motor_quantum], s[S.motor_noise])
        measured[i] = _read(x[i], deviation, quantum, x, i) if there else nan
        measured[5 + i] = _read(x[3 + i], s[S.velocity_noise], 0.0, x, 5 + i) if there else nan
    measured[8] = _read(link_torque, s[S.link_torque_noise], 0.0, x, 8) if transmissions > 0 else nan


@_compiled
def run(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """N ticks of state x in place under commands (N, 4) -> measured (N+1, 9), truth (N+1, 16); row 0 is the start."""
    springs = p[P.spring : P.spring + 2 * N_COEFFICIENTS].reshape(2, N_COEFFICIENTS)
    u, stage, y, torque = np.zeros(4), np.zeros(6), np.zeros(6), np.zeros(3)
    weights, event_weights = np.zeros((3, _N_WEIGHTS)), np.zeros((3, _N_WEIGHTS))
    key, event_key = np.full(2, nan), np.full(2, nan)
    slips, flanks, n = np.zeros(3, np.int64), np.zeros(2, np.int64), np.zeros((5, 3))
    observe(p, springs, s, x, measured[0], truth[0])
    for k in range(len(commands)):
        _tick(
            p, springs, x, commands[k], u, slips, flanks, weights, key, event_weights, event_key, stage, n, torque, y
        )  # fmt: skip
        observe(p, springs, s, x, measured[k + 1], truth[k + 1])


@_compiled
def run_many(rows: Array, states: Array, commands: Array, out: Array) -> None:
    """One run per parameter row (K, N_PARAMETERS), states (K, n) in place, commands (N, 4) shared -> out (K, N+1, 6)."""
    u, stage, y, torque = np.zeros(4), np.zeros(6), np.zeros(6), np.zeros(3)
    weights, event_weights = np.zeros((3, _N_WEIGHTS)), np.zeros((3, _N_WEIGHTS))
    key, event_key = np.empty(2), np.empty(2)
    slips, flanks, n = np.zeros(3, np.int64), np.zeros(2, np.int64), np.zeros((5, 3))
    for j in range(len(rows)):
        p, x = rows[j], states[j]
        springs = p[P.spring : P.spring + 2 * N_COEFFICIENTS].reshape(2, N_COEFFICIENTS)
        key[0] = event_key[0] = nan
        out[j, 0] = x[:6]
        for k in range(len(commands)):
            _tick(
                p, springs, x, commands[k], u, slips, flanks, weights, key, event_weights, event_key, stage, n, torque, y
            )  # fmt: skip
            out[j, k + 1] = x[:6]
