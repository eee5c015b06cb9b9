"""The one compiled joint: right-hand side, exponential integrator with events, tick.

Equations (notation.md), for the axes link (M, q), motor 1 and motor 2 (B_i, theta_i), phi_i = q - theta_i:

    M qdd     + (Dq + d) qd + F_q    = tau_ext - sum_i tau_e,i(phi_i) - g(q)
    B_i thdd_i + Dth_i thd_i + F_i   = tau_i + tau_e,i(phi_i)              or theta_i follows its servo in closed form

**Why this integrator.** The document's cubic joint has D/B = 12700 1/s under a 1 ms tick: explicit methods are
unstable, and every held command starts a boundary layer of 80 us in the motor's speed. But the stiff part is known,
linear and diagonal: L = [[0, 1], [0, -a]] per axis, a = viscous friction / inertia. An exponential Runge-Kutta method
integrates it exactly and the rest to fourth order: Krogstad's, whose third stage starts from u_n and not from another
stage, so that it loses less order on stiff problems than Cox and Matthews' (Hochbruck, Ostermann 2010, section 5.4). No
Jacobian, no linear solve, no iteration, and with a = 0 it is the classical method. Applied to a torque,
phi_k(hL) (0, f)' is (h phi_{k+1}(-ha) f, phi_k(-ha) f)', hence the position weights below. What stays explicit
(springs against inertia or viscous friction, coupling dampers, the Stribeck curve) sets the number of substeps, see
`plants.substeps_for`. Measured on that joint (10 s under E1): one step per tick errs by 2e-6 rad, the three that
`substeps_for` chooses by 1.3e-7 rad, and the error falls by 14 to 16 per halving.

**Dry friction and backlash are sets, not smoothed signs.** Within a step each axis either slips one way (friction
constant in sign) or is stuck (acceleration zero, friction takes whatever it must), and each transmission is in its gap
or on one flank; so the right-hand side is smooth. A step that leaves its mode is cut at the event, located to 1e-12 of
the step. A stuck axis does not move by one bit. Modes follow from the state at the start of a step: at speed zero an
axis is stuck exactly while |torque| <= breakaway.

Sources: Krogstad, Generalized integrating factor methods for stiff PDEs, J. Comput. Phys. 203 (2005), the scheme there
called ETDRK4-B; Piiroinen, Kuznetsov, An event-driven method to simulate Filippov systems, ACM TOMS 34 (2008).

**Reference counts.** Functions of the inner loop are compiled without numba's runtime (`_nrt=False`): they allocate
nothing, and counting references to their array arguments took three quarters of the time. They must return no array.
"""

from __future__ import annotations

from collections import namedtuple
from math import ceil, copysign, cos, exp, floor, inf, log, nan, pi, sin, sqrt
from typing import Any

import numpy as np
from numba import njit
from via_core.dampers import damper_value
from via_core.servos import servo_step
from via_core.signals import Array
from via_core.springs import N_COEFFICIENTS, spring_stiffness, spring_torque

from via_sim.parameters import AT_TRANSMISSION, DYNAMIC, MOTOR_2, NO_DAMPER, SERVO, P
from via_sim.phi_functions import phi_functions

# State row, everything there is to know of a joint at a tick; X says where each part begins:
#   position (3) [rad] and velocity (3) [rad/s] of link, motor 1, motor 2; tick: number of this one; seed of the noise;
#   reported_torque (2) [N m] commanded over the last tick; motor_torque (2) [N m] or [rad], damping [N m s/rad] and
#   external torque [N m] that then acted; queue (L, QUEUED): the last L commands, a ring by tick, for the dead time.
State = namedtuple("State", "position velocity tick seed reported_torque motor_torque damping external queue")
X: Any = State(0, 3, 6, 7, 8, 10, 12, 13, 14)
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
    "stiffness_2", "damping", "deflection_1", "deflection_2", "motor_torque_1", "motor_torque_2",
    "transmission_torque_1", "transmission_torque_2",
)  # fmt: skip

# Sensor row; a noise of NaN means 'not measured', a quantum of 0 'not quantised'.
SensorSlots = namedtuple(
    "SensorSlots", "link_quantum motor_quantum link_noise motor_noise velocity_noise torque_noise link_torque_noise"
)
S: Any = SensorSlots(*range(7))

# Modes (6,): of the three axes _STUCK, _SMOOTH (no dry friction) or slip direction -1, +1; of the two transmissions the
# flank they lie on, 0 within the gap; last, whether there is any dry friction or backlash at all.
_STUCK, _SMOOTH, _FLANK, _SWITCHES = 0, 2, 3, 5
_PER_AXIS, _FOR = 20, 60  # integrator weights per axis; where step and damping stand that they are for
_MAX_EVENTS = 64  # per substep
_EVENT_WIDTH = 1e-12  # of a substep: how exactly an event is located
_compiled = njit(cache=True, error_model="numpy", nogil=True)
_bare = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)


@_bare
def transmission_torque(p: Array, c: Array, i: int, phi: float, preset: float, flank: int) -> float:
    """tau_e,i [N m] at deflection phi; `flank` is 0 inside the backlash gap, else its side -1 or +1."""
    gap = p[P.backlash + i]
    if gap > 0.0:
        if flank == 0:
            return 0.0
        phi -= flank * 0.5 * gap
    kind, stop = int(p[P.spring_kind + i]), p[P.stop + i]
    if abs(phi) > stop:  # along the tangent: beyond its stop a law explodes or ends
        edge = copysign(stop, phi)
        return spring_torque(kind, c, edge, preset) + max(spring_stiffness(kind, c, edge, preset), 0.0) * (phi - edge)
    return spring_torque(kind, c, phi, preset)


@_bare
def transmission_stiffness(p: Array, c: Array, i: int, phi: float, preset: float) -> float:
    """sigma_i [N m/rad] at deflection phi."""
    gap = p[P.backlash + i]
    if gap > 0.0:
        if abs(phi) < 0.5 * gap:
            return 0.0
        phi -= copysign(0.5 * gap, phi)
    kind, stop = int(p[P.spring_kind + i]), p[P.stop + i]
    if abs(phi) > stop:
        return max(spring_stiffness(kind, c, copysign(stop, phi), preset), 0.0)
    return spring_stiffness(kind, c, phi, preset)


@_bare
def motive_torques(
    p: Array, c1: Array, c2: Array, modes: Array, u: Array, q: float, m1: float, m2: float, w: float, w1: float
) -> tuple[float, float, float]:
    """Torque [N m] on link, motor 1 and motor 2 but for their own viscous and dry friction.

    modes (6,); u (4,) torques of the motors, damping [N m s/rad], external torque; angles q, m1, m2 [rad]; velocities
    w, w1 [rad/s] of link and motor 1 (only a damper in the transmission looks at them).
    """
    link, first, second = u[EXTERNAL], u[M1], u[M2]
    if p[P.gravity_torque] != 0.0:
        link -= p[P.gravity_torque] * sin(q - p[P.gravity_angle])
    if p[P.transmissions] > 0.0:
        torque = transmission_torque(p, c1, 0, q - m1, m2 if p[P.serial] != 0.0 else m1, modes[_FLANK])
        link -= torque
        first += torque
    if p[P.transmissions] > 1.0:
        torque = transmission_torque(p, c2, 1, q - m2, m2, modes[_FLANK + 1])
        link -= torque
        second += torque
    if p[P.damper_site] == AT_TRANSMISSION:  # of transmission 1; the diagonal part is in `viscous_rate`
        link += u[DAMPING] * w1
        first += u[DAMPING] * w
    return link, first, second


@_bare
def viscous_rate(p: Array, axis: int, damping: float) -> float:
    """a = viscous friction / inertia [1/s] of an axis, damper included."""
    site, viscous = p[P.damper_site], p[P.viscous_friction + axis]
    if (axis == 0 and site != NO_DAMPER) or (axis == 1 and site == AT_TRANSMISSION):
        viscous += damping
    return viscous / p[P.inertia + axis]


@_bare
def dry_friction(p: Array, axis: int, speed: float) -> float:
    """Magnitude [N m] of the friction on an axis that slips with speed >= 0 (Stribeck curve)."""
    kinetic = p[P.kinetic_friction + axis]
    excess = p[P.breakaway_friction + axis] - kinetic
    if excess == 0.0:
        return kinetic
    ratio = speed / p[P.stribeck_velocity + axis]
    return kinetic + excess * exp(-ratio * ratio)


@_bare
def settle(p: Array, c1: Array, c2: Array, x: Array, u: Array, modes: Array) -> None:
    """The modes that state x is in -> modes (6,)."""
    modes[_SWITCHES] = 0
    for i in range(2):
        half = 0.5 * p[P.backlash + i]
        if half > 0.0:
            phi = x[0] - x[1 + i]
            modes[_FLANK + i] = 0 if abs(phi) < half else (1 if phi > 0.0 else -1)
            modes[_SWITCHES] = 1
    for i in range(3):
        modes[i] = _SMOOTH
        if p[P.breakaway_friction + i] > 0.0 and p[P.axis_kind + i] == DYNAMIC:
            modes[i] = _STUCK
            modes[_SWITCHES] = 1
    if modes[_SWITCHES] != 0:
        torques = motive_torques(p, c1, c2, modes, u, x[0], x[1], x[2], x[3], x[4])
        for i, torque in enumerate(torques):
            if modes[i] != _SMOOTH and (x[3 + i] != 0.0 or abs(torque) > p[P.breakaway_friction + i]):
                modes[i] = 1 if (x[3 + i] if x[3 + i] != 0.0 else torque) > 0.0 else -1


@_bare
def _driven(p: Array, axis: int, mode: int, torque: float, velocity: float) -> float:
    """Torque [N m] that accelerates an axis in its mode, dry friction included."""
    if mode == _STUCK:
        return 0.0
    if mode != _SMOOTH:
        torque -= mode * dry_friction(p, axis, mode * velocity)
    return torque


@_bare
def _forced(
    p: Array, c1: Array, c2: Array, modes: Array, u: Array,
    q: float, m1: float, m2: float, w: float, w1: float, w2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Torque [N m] on each axis but for its viscous friction: what the exponential does not cover."""
    t0, t1, t2 = motive_torques(p, c1, c2, modes, u, q, m1, m2, w, w1)
    return _driven(p, 0, modes[0], t0, w), _driven(p, 1, modes[1], t1, w1), _driven(p, 2, modes[2], t2, w2)


@_compiled
def derivative(p: Array, x: Array, u: Array, out: Array) -> None:
    """The right-hand side: d/dt (positions, velocities) -> out (6,), friction resolved as a set at standstill.

    Servo axes move with their own velocity and report zero acceleration: their closed form is in `servo_step`.
    """
    modes, (c1, c2) = np.zeros(6, np.int64), _laws(p)
    settle(p, c1, c2, x, u, modes)
    forced = _forced(p, c1, c2, modes, u, x[0], x[1], x[2], x[3], x[4], x[5])
    for i, torque in enumerate(forced):
        out[i] = x[3 + i]
        out[3 + i] = 0.0
        if p[P.axis_kind + i] == DYNAMIC:
            out[3 + i] = torque / p[P.inertia + i] - viscous_rate(p, i, u[DAMPING]) * x[3 + i]


@_compiled
def _laws(p: Array) -> tuple[Array, Array]:
    """Coefficient rows of the two springs."""
    return p[P.spring : P.spring + N_COEFFICIENTS], p[P.spring + N_COEFFICIENTS : P.spring + 2 * N_COEFFICIENTS]


@_bare
def _weigh(p: Array, h: float, damping: float, weights: Array) -> None:
    """Krogstad's weights for step h -> weights (62,): 20 per axis, then the step and damping they are for."""
    if weights[_FOR] == h and weights[_FOR + 1] == damping:
        return
    weights[_FOR], weights[_FOR + 1] = h, damping
    for i in range(3):
        w = weights[_PER_AXIS * i : _PER_AXIS * (i + 1)]
        if p[P.axis_kind + i] != DYNAMIC:
            for j in range(_PER_AXIS):
                w[j] = 0.0
            continue
        z = -viscous_rate(p, i, damping) * h
        e, p1, p2, p3, p4 = phi_functions(z)
        eh, h1, h2, h3, _ = phi_functions(0.5 * z)
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
        for j in range(4, _PER_AXIS):
            w[j] /= p[P.inertia + i]  # N are torques


@_bare
def _drift(p: Array, x: Array, u: Array, h: float, axis: int, w: float, w_angle: float) -> tuple[float, float]:
    """Angle and velocity of a motor after h [s] without its forced part; all of the motion of a servo."""
    angle, velocity = x[axis] + w_angle * x[3 + axis], w * x[3 + axis]
    if p[P.axis_kind + axis] == SERVO:
        angle, velocity = servo_step(x[axis], x[3 + axis], u[axis - 1], p[P.bandwidth + axis - 1], h)
    return angle, velocity


@_bare
def _step(p: Array, c1: Array, c2: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array) -> None:
    """One Krogstad step of h [s] in fixed modes: x (6,) -> y (9,), whose tail holds the velocities at the midpoint."""
    _weigh(p, h, u[DAMPING], weights)
    w = weights
    half0, speed0 = x[0] + w[1] * x[3], w[0] * x[3]  # the linear part at the midpoint
    half1, speed1 = _drift(p, x, u, 0.5 * h, 1, w[20], w[21])
    half2, speed2 = _drift(p, x, u, 0.5 * h, 2, w[40], w[41])
    full0, end0 = x[0] + w[3] * x[3], w[2] * x[3]  # and at the end
    full1, end1 = _drift(p, x, u, h, 1, w[22], w[23])
    full2, end2 = _drift(p, x, u, h, 2, w[42], w[43])
    n0, n1, n2 = _forced(p, c1, c2, modes, u, x[0], x[1], x[2], x[3], x[4], x[5])
    v0, v1, v2 = speed0 + w[4] * n0, speed1 + w[24] * n1, speed2 + w[44] * n2
    a0, a1, a2 = _forced(
        p, c1, c2, modes, u, half0 + w[5] * n0, half1 + w[25] * n1, half2 + w[45] * n2, v0, v1, v2
    )  # fmt: skip
    r0, r1, r2 = speed0 + w[6] * n0 + w[8] * a0, speed1 + w[26] * n1 + w[28] * a1, speed2 + w[46] * n2 + w[48] * a2
    # the mean of both stages is the speed at the midpoint of torques that change evenly; each alone is off by O(h^2)
    y[6], y[7], y[8] = 0.5 * (v0 + r0), 0.5 * (v1 + r1), 0.5 * (v2 + r2)
    b0, b1, b2 = _forced(
        p, c1, c2, modes, u, half0 + w[7] * n0 + w[9] * a0, half1 + w[27] * n1 + w[29] * a1,
        half2 + w[47] * n2 + w[49] * a2, r0, r1, r2,
    )  # fmt: skip
    d0, d1, d2 = _forced(
        p, c1, c2, modes, u, full0 + w[11] * n0 + w[13] * b0, full1 + w[31] * n1 + w[33] * b1,
        full2 + w[51] * n2 + w[53] * b2, end0 + w[10] * n0 + w[12] * b0, end1 + w[30] * n1 + w[32] * b1,
        end2 + w[50] * n2 + w[52] * b2,
    )  # fmt: skip
    a0, a1, a2 = a0 + b0, a1 + b1, a2 + b2
    y[0] = full0 + w[15] * n0 + w[17] * a0 + w[19] * d0
    y[1] = full1 + w[35] * n1 + w[37] * a1 + w[39] * d1
    y[2] = full2 + w[55] * n2 + w[57] * a2 + w[59] * d2
    y[3] = end0 + w[14] * n0 + w[16] * a0 + w[18] * d0
    y[4] = end1 + w[34] * n1 + w[36] * a1 + w[38] * d1
    y[5] = end2 + w[54] * n2 + w[56] * a2 + w[58] * d2


@_bare
def _violation(p: Array, c1: Array, c2: Array, y: Array, u: Array, modes: Array) -> float:
    """How far state y lies outside the modes it was reached in; <= 0 inside. Continuous along a trajectory."""
    worst = -inf
    torques = motive_torques(p, c1, c2, modes, u, y[0], y[1], y[2], y[3], y[4])
    for i, torque in enumerate(torques):
        if modes[i] == _STUCK:
            worst = max(worst, abs(torque) - p[P.breakaway_friction + i])
        elif modes[i] != _SMOOTH:
            worst = max(worst, -modes[i] * y[3 + i])
    for i in range(2):
        half = 0.5 * p[P.backlash + i]
        if half > 0.0:
            phi, flank = y[0] - y[1 + i], modes[_FLANK + i]
            worst = max(worst, abs(phi) - half if flank == 0 else half - flank * phi)
    return worst


@_bare
def _dips(modes: Array, y: Array) -> bool:
    """Whether a slipping axis ran backwards at the midpoint though not at the end: it touched zero on the way."""
    back = False
    for i in range(3):
        back |= abs(modes[i]) == 1 and modes[i] * y[6 + i] < 0.0
    return back


@_bare
def _advance(
    p: Array, c1: Array, c2: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array
) -> None:
    """x (6,) moves on by h [s] in place, cut at every event. weights (2, 62): of whole substeps, of their pieces."""
    if modes[_SWITCHES] == 0:
        _step(p, c1, c2, x, u, h, modes, weights[0], y)
        for i in range(6):
            x[i] = y[i]
        return
    left = h
    for event in range(_MAX_EVENTS):
        settle(p, c1, c2, x, u, modes)
        high = left
        _step(p, c1, c2, x, u, high, modes, weights[min(event, 1)], y)
        outside = _violation(p, c1, c2, y, u, modes)
        if outside <= 0.0 and _dips(modes, y):
            _step(p, c1, c2, x, u, 0.5 * left, modes, weights[1], y)
            outside = _violation(p, c1, c2, y, u, modes)
            if outside > 0.0:
                high = 0.5 * left
            else:
                _step(p, c1, c2, x, u, left, modes, weights[1], y)
        if outside > 0.0:  # Illinois: in its modes at `low`, outside at `high`
            low, at_low, at_high = 0.0, _violation(p, c1, c2, x, u, modes), outside
            for trial in range(100):
                if high - low <= _EVENT_WIDTH * h:
                    break
                share = at_low / (at_low - at_high) if at_low < 0.0 and trial % 4 != 3 else 0.5
                middle = low + (high - low) * min(max(share, 1e-9), 1.0 - 1e-9)
                _step(p, c1, c2, x, u, middle, modes, weights[1], y)
                outside = _violation(p, c1, c2, y, u, modes)
                if outside > 0.0:
                    high, at_high, at_low = middle, outside, 0.5 * at_low
                else:
                    low, at_low, at_high = middle, outside, 0.5 * at_high
            _step(p, c1, c2, x, u, high, modes, weights[1], y)
        left -= high
        for i in range(3):
            if abs(modes[i]) == 1 and modes[i] * y[3 + i] <= 0.0:
                y[3 + i] = 0.0  # it stops; `settle` decides whether it stays
        for i in range(6):
            x[i] = y[i]
        if left <= 0.0:
            return
    for i in range(3):  # chattering beyond all measure: rest for what is left of this substep
        if abs(modes[i]) == 1:
            x[3 + i] = 0.0


@_bare
def _tick(
    p: Array, c1: Array, c2: Array, x: Array, command: Array, u: Array, modes: Array, weights: Array, y: Array
) -> None:
    """State x lives through one tick under `command` (4,), in place."""
    tick, length = int(x[X.tick]), (x.size - X.queue) // QUEUED
    now = X.queue + QUEUED * (tick % length)
    for i in range(QUEUED):
        x[now + i] = command[i]
    for i in range(2):
        x[X.reported_torque + i] = min(max(command[i], -p[P.torque_limit + i]), p[P.torque_limit + i])
    u[EXTERNAL] = x[X.external] = command[EXTERNAL]
    period = p[P.tick]
    whole = floor(p[P.delay] / period + 1e-9)
    rest = p[P.delay] - whole * period
    if rest < 1e-9 * period:
        rest = 0.0
    for piece in range(2):  # until the command of this tick arrives, and from then on
        duration = rest if piece == 0 else period - rest
        if duration <= 0.0:
            continue
        held = X.queue + QUEUED * ((tick - whole - (1 - piece)) % length)
        for i in range(2):
            limit = p[P.torque_limit + i]
            u[i] = 0.0
            if p[P.axis_kind + 1 + i] == SERVO:
                u[i] = x[held + i]
            elif p[P.axis_kind + 1 + i] == DYNAMIC:
                u[i] = p[P.torque_gain + i] * min(max(x[held + i], -limit), limit)
            x[X.motor_torque + i] = u[i]
        u[DAMPING] = 0.0
        if p[P.damper_site] != NO_DAMPER:
            u[DAMPING] = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[held + DAMPING])
        x[X.damping] = u[DAMPING]
        substeps = max(1, ceil(p[P.substeps] * duration / period - 1e-9))
        h = duration / substeps
        for _ in range(substeps):
            _advance(p, c1, c2, x, u, h, modes, weights, y)
    x[X.tick] += 1.0


@_bare
def _uniform(seed: np.uint64, tick: np.uint64, channel: np.uint64) -> float:
    """A uniform number in (0, 1) that is a pure function of its three counters (splitmix64 finaliser, twice)."""
    z = seed * np.uint64(0xD1342543DE82EF95) + tick * np.uint64(32) + channel
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (float(z >> np.uint64(11)) + 0.5) / 9007199254740992.0


@_bare
def noise(x: Array, channel: int) -> float:
    """A standard normal number for this channel at this tick: Box-Muller on counters, no hidden state."""
    seed, tick = np.uint64(x[X.seed]), np.uint64(x[X.tick])
    one = _uniform(seed, tick, np.uint64(2 * channel))
    two = _uniform(seed, tick, np.uint64(2 * channel + 1))
    return sqrt(-2.0 * log(one)) * cos(2.0 * pi * two)


@_bare
def _read(true: float, deviation: float, quantum: float, x: Array, channel: int) -> float:
    """A sensor: noise first, then the quantiser, as in an encoder."""
    value = true
    if deviation != 0.0:
        value += deviation * noise(x, channel)
    return quantum * np.rint(value / quantum) if quantum > 0.0 else value


@_bare
def dissipated_torque(p: Array, x: Array) -> float:
    """Torque [N m] in the clutch of a rigid joint, positive as d qd: its damper's and the dry friction at the link.

    At standstill friction takes what the external torque and gravity ask of it, up to breakaway.
    """
    speed = x[3]
    if speed != 0.0:
        return x[X.damping] * speed + copysign(dry_friction(p, 0, abs(speed)), speed)
    asked = x[X.external] - p[P.gravity_torque] * sin(x[0] - p[P.gravity_angle])
    return min(max(asked, -p[P.breakaway_friction]), p[P.breakaway_friction])


@_bare
def observe(p: Array, c1: Array, c2: Array, s: Array, x: Array, measured: Array, truth: Array) -> None:
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
        c = c1 if i == 0 else c2
        phi, preset = x[0] - x[1 + i], x[MOTOR_2] if p[P.serial] != 0.0 else x[1 + i]
        flank = 0 if abs(phi) < 0.5 * p[P.backlash + i] else (1 if phi > 0.0 else -1)
        truth[7 + i] = transmission_stiffness(p, c, i, phi, preset)
        truth[6] += truth[7 + i]
        truth[10 + i] = phi
        truth[14 + i] = transmission_torque(p, c, i, phi, preset, flank)
        link_torque += truth[14 + i]
    for i in range(3):
        there = p[P.axis_kind + i] != 0.0
        quantum, deviation = (s[S.link_quantum], s[S.link_noise]) if i == 0 else (s[S.motor_quantum], s[S.motor_noise])
        measured[i] = _read(x[i], deviation, quantum, x, i) if there else nan
        measured[5 + i] = _read(x[3 + i], s[S.velocity_noise], 0.0, x, 5 + i) if there else nan
    if transmissions == 0:
        link_torque = dissipated_torque(p, x)
    measured[8] = _read(link_torque, s[S.link_torque_noise], 0.0, x, 8)


@_compiled
def run(p: Array, s: Array, x: Array, commands: Array, measured: Array, truth: Array) -> None:
    """N ticks of state x in place under commands (N, 4) -> measured (N+1, 9), truth (N+1, 16); row 0 is the start."""
    c1, c2 = _laws(p)
    u, modes, weights, y = np.zeros(4), np.zeros(6, np.int64), np.full((2, _FOR + 2), nan), np.zeros(9)
    settle(p, c1, c2, x, u, modes)
    observe(p, c1, c2, s, x, measured[0], truth[0])
    for k in range(len(commands)):
        _tick(p, c1, c2, x, commands[k], u, modes, weights, y)
        observe(p, c1, c2, s, x, measured[k + 1], truth[k + 1])


@_compiled
def run_many(rows: Array, states: Array, commands: Array, out: Array) -> None:
    """One run per row (K, N_PARAMETERS), states (K, n) in place, commands (N, 4) shared -> motion out (K, N+1, 6)."""
    u, modes, weights, y = np.zeros(4), np.zeros(6, np.int64), np.empty((2, _FOR + 2)), np.zeros(9)
    for j in range(len(rows)):
        p, x = rows[j], states[j]
        c1, c2 = _laws(p)
        weights[:] = nan
        settle(p, c1, c2, x, u, modes)
        out[j, 0] = x[:6]
        for k in range(len(commands)):
            _tick(p, c1, c2, x, commands[k], u, modes, weights, y)
            out[j, k + 1] = x[:6]
