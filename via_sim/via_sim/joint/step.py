"""One step of the exponential integrator between events.

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

Source: Krogstad, Generalized integrating factor methods for stiff PDEs, J. Comput. Phys. 203 (2005), scheme ETDRK4-B.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

from via_core.signals import Array

from via_sim.joint.actuation import servo_motion, supply
from via_sim.joint.compiled import bare, inlined
from via_sim.joint.friction import viscous_rate
from via_sim.joint.layout import DAMPING, MODE
from via_sim.joint.parameters import DYNAMIC, SERVO, P
from via_sim.joint.phi_functions import phi_functions
from via_sim.joint.structure import EVERYTHING
from via_sim.joint.torques import forced, motive_torques

# Krogstad's weights of one axis, for velocity and (next column) angle: linear part over half a step and a full step,
# then weights of the torques N(u_n), N(a), N(b), N(c) in stages a, b, c and in the result (N(a) and N(b) share one).
_Weights = namedtuple("_Weights", "half full a_n b_n b_a c_n c_b end_n end_ab end_c")
W: Any = _Weights(*range(0, 20, 2))
PER_AXIS, _FOR = 20, 60  # columns per axis; first of the two columns that hold the step and the damping they are for
N_WEIGHTS = _FOR + 2


@inlined
def is_for(weights: Array, h: float, damping: float) -> bool:
    """Whether weights (N_WEIGHTS,) are those for step h [s] and a damping [N m s/rad]."""
    return weights[_FOR] == h and weights[_FOR + 1] == damping


@bare
def weigh(p: Array, h: float, damping: float, weights: Array) -> None:
    """Krogstad's weights for step h [s] into weights (N_WEIGHTS,), see `W`."""
    weights[_FOR], weights[_FOR + 1] = h, damping
    for i in range(3):
        w = weights[PER_AXIS * i : PER_AXIS * (i + 1)]
        if p[P.axis_kind + i] != DYNAMIC:
            for j in range(PER_AXIS):
                w[j] = 0.0
            continue
        z = -viscous_rate(p, i, damping) * h
        of_axis = axis_weights(h, h / p[P.inertia + i], phi_functions(z), phi_functions(0.5 * z))
        for j in range(PER_AXIS):
            w[j] = of_axis[j]


@inlined
def axis_weights(h: Any, k: Any, full: Any, half: Any) -> Any:
    """The weights of an axis in the order of `W`: numbers, or packs of several runs.

    h           [s] length of the step
    k           h over the inertia, since Krogstad's N are torques
    full, half  phi_0 to phi_4 at -h and -h/2 times the viscous rate
    """
    e, p1, p2, p3, p4 = full
    eh, h1, h2, h3, _ = half
    return (
        eh, 0.5 * h * h1,
        e, h * p1,
        0.5 * k * h1, 0.25 * h * k * h2,
        k * (0.5 * h1 - h2), 0.5 * h * k * (0.5 * h2 - h3),
        k * h2, 0.5 * h * k * h3,
        k * (p1 - 2.0 * p2), h * k * (p2 - 2.0 * p3),
        2.0 * k * p2, 2.0 * h * k * p3,
        k * (p1 - 3.0 * p2 + 4.0 * p3), h * k * (p2 - 3.0 * p3 + 4.0 * p4),
        k * (2.0 * p2 - 4.0 * p3), h * k * (2.0 * p3 - 4.0 * p4),
        k * (4.0 * p3 - p2), h * k * (4.0 * p4 - p3),
    )  # fmt: skip


@bare
def _drift(
    p: Array, has: Any, u: Array, h: float, axis: int, angle: float, velocity: float, w: float, w_angle: float
) -> tuple[float, float]:  # fmt: skip
    """Angle and velocity of a motor after h [s] without forced part, or the full motion of a servo."""
    if has.rest is not None and p[P.axis_kind + axis] == SERVO:
        return servo_motion(p, axis - 1, angle, velocity, u[axis - 1], h)
    return angle + w_angle * velocity, w * velocity


@inlined
def _torques(
    p: Array, has: Any, modes: Array, u: Array, x: Array,
    q: float, m1: float, m2: float, w: float, w1: float, w2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """`forced`, part of the step itself where it is short."""
    if has.rest is None:
        t0, t1, t2, _, _, _ = motive_torques(p, has, modes, u, x, q, m1, m2, w, w1, w2)
        return t0, t1, t2
    return forced(p, modes, u, x, q, m1, m2, w, w1, w2)


@inlined
def stepped(p: Array, has: Any, x: Array, motion: Any, u: Any, h: float, modes: Array, w: Any) -> Any:
    """One Krogstad step of h [s] in fixed modes: the motion (6) at the end, then the velocities (3) at the midpoint.

    motion  angles and velocities (6) at the beginning
    x       state whose elements with memory count
    w       weights of the three axes, see `W`
    """
    q, m1, m2, s0, s1, s2 = motion
    w0, w1, w2 = w
    half0, speed0 = q + w0[W.half + 1] * s0, w0[W.half] * s0  # linear part at the midpoint
    half1, speed1 = _drift(p, has, u, 0.5 * h, 1, m1, s1, w1[W.half], w1[W.half + 1])
    half2, speed2 = _drift(p, has, u, 0.5 * h, 2, m2, s2, w2[W.half], w2[W.half + 1])
    full0, end0 = q + w0[W.full + 1] * s0, w0[W.full] * s0  # linear part at the end
    full1, end1 = _drift(p, has, u, h, 1, m1, s1, w1[W.full], w1[W.full + 1])
    full2, end2 = _drift(p, has, u, h, 2, m2, s2, w2[W.full], w2[W.full + 1])
    if has.rest is not None and modes[MODE.lags] != 0:
        supply(p, has, modes, x, u, 0.0)
    n0, n1, n2 = _torques(p, has, modes, u, x, q, m1, m2, s0, s1, s2)
    v0, v1, v2 = speed0 + w0[W.a_n] * n0, speed1 + w1[W.a_n] * n1, speed2 + w2[W.a_n] * n2
    if has.rest is not None and modes[MODE.lags] != 0:
        supply(p, has, modes, x, u, 0.5 * h)
    a0, a1, a2 = _torques(
        p, has, modes, u, x,
        half0 + w0[W.a_n + 1] * n0, half1 + w1[W.a_n + 1] * n1, half2 + w2[W.a_n + 1] * n2, v0, v1, v2,
    )  # fmt: skip
    r0, r1 = speed0 + w0[W.b_n] * n0 + w0[W.b_a] * a0, speed1 + w1[W.b_n] * n1 + w1[W.b_a] * a1
    r2 = speed2 + w2[W.b_n] * n2 + w2[W.b_a] * a2
    b0, b1, b2 = _torques(
        p, has, modes, u, x,
        half0 + w0[W.b_n + 1] * n0 + w0[W.b_a + 1] * a0, half1 + w1[W.b_n + 1] * n1 + w1[W.b_a + 1] * a1,
        half2 + w2[W.b_n + 1] * n2 + w2[W.b_a + 1] * a2, r0, r1, r2,
    )  # fmt: skip
    if has.rest is not None and modes[MODE.lags] != 0:
        supply(p, has, modes, x, u, h)
    d0, d1, d2 = _torques(
        p, has, modes, u, x,
        full0 + w0[W.c_n + 1] * n0 + w0[W.c_b + 1] * b0, full1 + w1[W.c_n + 1] * n1 + w1[W.c_b + 1] * b1,
        full2 + w2[W.c_n + 1] * n2 + w2[W.c_b + 1] * b2,
        end0 + w0[W.c_n] * n0 + w0[W.c_b] * b0, end1 + w1[W.c_n] * n1 + w1[W.c_b] * b1,
        end2 + w2[W.c_n] * n2 + w2[W.c_b] * b2,
    )  # fmt: skip
    a0, a1, a2, both0, both1, both2 = a0 + b0, a1 + b1, a2 + b2, v0 + r0, v1 + r1, v2 + r2
    return (
        full0 + w0[W.end_n + 1] * n0 + w0[W.end_ab + 1] * a0 + w0[W.end_c + 1] * d0,
        full1 + w1[W.end_n + 1] * n1 + w1[W.end_ab + 1] * a1 + w1[W.end_c + 1] * d1,
        full2 + w2[W.end_n + 1] * n2 + w2[W.end_ab + 1] * a2 + w2[W.end_c + 1] * d2,
        end0 + w0[W.end_n] * n0 + w0[W.end_ab] * a0 + w0[W.end_c] * d0,
        end1 + w1[W.end_n] * n1 + w1[W.end_ab] * a1 + w1[W.end_c] * d1,
        end2 + w2[W.end_n] * n2 + w2[W.end_ab] * a2 + w2[W.end_c] * d2,
        # For torques linear in time the mean of stages a and b is the exact midpoint velocity; each errs by O(h^2).
        0.5 * both0, 0.5 * both1, 0.5 * both2,
    )  # fmt: skip


@bare
def krogstad_step(p: Array, x: Array, u: Array, h: float, modes: Array, weights: Array, y: Array) -> None:
    """One Krogstad step of h [s] in fixed modes from x into y (9,): motion at the end, velocities at the midpoint."""
    if not is_for(weights, h, u[DAMPING]):
        weigh(p, h, u[DAMPING], weights)
    w = weights[:PER_AXIS], weights[PER_AXIS : 2 * PER_AXIS], weights[2 * PER_AXIS : 3 * PER_AXIS]
    y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8] = stepped(
        p, EVERYTHING, x, (x[0], x[1], x[2], x[3], x[4], x[5]), u, h, modes, w
    )
