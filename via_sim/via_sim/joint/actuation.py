"""Drives from command to acting torque: saturation, lag, gain and bias; servos with a speed limit.

    command -> dead time -> limit (reported by the drive) -> saturation (unknown) -> lag -> gain, bias -> axis

Under a constant command the lag T y' = u - y has the closed form y(s) = u + (y(0) - u) exp(-s/T). The integrator's
stages evaluate it at their own times, so it needs no extra steps. A servo of bandwidth w lags by 2/w; an additional lag
T makes that 2/w + T. A servo at its speed limit moves with constant speed until its control law demands less. The end
of this phase has a closed form; its beginning is found by bisection of a monotone closed form.
"""

from __future__ import annotations

from math import copysign, exp, inf
from typing import Any

from via_core.servos import servo_acceleration, servo_step
from via_core.signals import Array

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.layout import EXTERNAL, MODE, U, X
from via_sim.joint.parameters import DYNAMIC, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.position_drive import acting_goal

_PHASES = 4  # free, limited, free again, and limited in the other direction


@bare
def lagged(p: Array, axis: int, x: Array, u: Array, after: float) -> float:
    """Drive torque [N m] behind the lag, `after` [s] later than state x."""
    target = u[U.target + axis]
    return target + (x[X.lag + axis] - target) * exp(-after / p[P.lag])


@bare
def couple(p: Array, neighbour: float, arm: float, u: Array) -> None:
    """Torques that are not from the drives into u (N_INPUTS,): coupling to the `neighbour` [rad], arm [N m]."""
    through1, through2 = p[P.coupling + 1] * neighbour, p[P.coupling + 2] * neighbour
    u[U.beside] = p[P.coupling] * neighbour + through1 + through2 + arm
    u[U.beside + 1], u[U.beside + 2] = -through1, -through2


@inlined
def supply(p: Array, has: Any, modes: Array, x: Array, u: Array, after: float) -> None:
    """Torques (and the goal of a position drive) `after` [s] later than state x into u (N_INPUTS,)."""
    u[EXTERNAL] = u[U.beside]
    if has.rest is not None and p[P.link_drive] == POSITION_DRIVE:
        u[U.acting] = acting_goal(p, u[U.target], u[U.followed], u[U.lagged], after)
    for axis in range(3):
        driven = p[P.link_drive] == TORQUE_DRIVE if axis == 0 else p[P.axis_kind + axis] == DYNAMIC
        if driven:
            torque = u[U.target + axis]
            if has.rest is not None and modes[MODE.lags] != 0:
                torque = lagged(p, axis, x, u, after)
            torque = p[P.torque_gain + axis] * torque + p[P.torque_bias + axis]
            if axis == 0:
                u[EXTERNAL] += torque
            else:
                u[axis - 1] = torque + u[U.beside + axis]


@bare
def servo_bandwidth(p: Array, i: int) -> float:
    """Bandwidth w [rad/s] of servo i, lag included."""
    w = p[P.bandwidth + i]
    return w if p[P.lag] <= 0.0 else w / (1.0 + 0.5 * w * p[P.lag])


@bare
def servo_motion(p: Array, i: int, x: float, v: float, u: float, left: float) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] of servo i, `left` [s] later, under the constant command u [rad]."""
    w, limit = servo_bandwidth(p, i), p[P.saturation + 1 + i]
    if limit == inf:
        return servo_step(x, v, u, w, left)
    for _ in range(_PHASES):
        e, b = x - u, v + w * (x - u)
        top = (b + v) / (w * b) if b != 0.0 else 0.0  # time of the extreme speed -b exp(-w top)
        if abs(v) >= limit and servo_acceleration(x, v, u, w) * v > 0.0:
            v = copysign(limit, v)
            slewing = min((-2.0 * v / w - e) / v, left)  # until the servo needs no more speed
            x, left = x + v * slewing, left - slewing
        elif top > 0.0 and abs(b) * exp(-w * min(top, left)) > limit and abs(v) < limit:
            low, high = 0.0, min(top, left)
            if abs((v - w * b * high) * exp(-w * high)) <= limit:
                break
            for _ in range(60):
                middle = 0.5 * (low + high)
                if abs((v - w * b * middle) * exp(-w * middle)) > limit:
                    high = middle
                else:
                    low = middle
            x, v = servo_step(x, v, u, w, high)
            v, left = copysign(limit, v), left - high
        else:
            break
    return servo_step(x, v, u, w, left)
