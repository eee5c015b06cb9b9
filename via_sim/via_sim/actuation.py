"""From command to what acts: saturation and lag of a drive, gain and bias of its torque, a servo that slews no faster.

    command -> dead time -> limit (the drive reports it) -> saturation (nobody knows) -> lag -> gain, bias -> axis

Under a held command the lag T y' = u - y is the closed form y(s) = u + (y(0) - u) exp(-s/T), so that the integrator's
stages get it at their own times and it costs no step. A servo of bandwidth w lags by 2/w; a lag T beside it makes that
2/w + T. A servo that reaches its speed limit slews at it until its error asks for less; both moments are found, the one
in closed form, the other by bisection of a monotone closed form.
"""

from __future__ import annotations

from math import copysign, exp, inf

from via_core.servos import servo_acceleration, servo_step
from via_core.signals import Array

from via_sim.parameters import DYNAMIC, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.position_drive import acting_goal
from via_sim.torques import ACTING, BESIDE, EXTERNAL, FOLLOWED, LAGGED, LAGS, TARGET, X, bare

_PHASES = 4  # free, slewing, free again, and one more should the command lie on the other side


@bare
def saturated(p: Array, axis: int, asked: float) -> float:
    """What a drive passes on of the torque [N m] it is asked for."""
    return min(max(asked, -p[P.saturation + axis]), p[P.saturation + axis])


@bare
def lagged(p: Array, axis: int, x: Array, u: Array, after: float) -> float:
    """Drive torque [N m] behind the lag, `after` [s] the state x."""
    target = u[TARGET + axis]
    return target + (x[X.lag + axis] - target) * exp(-after / p[P.lag])


@bare
def couple(p: Array, neighbour: float, arm: float, u: Array) -> None:
    """Torques on the axes beside their drives, of the neighbour's angle [rad] and the arm [N m] -> u (N_INPUTS,)."""
    through1, through2 = p[P.coupling + 1] * neighbour, p[P.coupling + 2] * neighbour
    u[BESIDE] = p[P.coupling] * neighbour + through1 + through2 + arm
    u[BESIDE + 1], u[BESIDE + 2] = -through1, -through2


@bare
def supply(p: Array, modes: Array, x: Array, u: Array, after: float) -> None:
    """Torques that act `after` [s] the state x, of a position drive its goal -> u (N_INPUTS,)."""
    u[EXTERNAL] = u[BESIDE]
    if p[P.link_drive] == POSITION_DRIVE:
        u[ACTING] = acting_goal(p, u[TARGET], u[FOLLOWED], u[LAGGED], after)
    for axis in range(3):
        driven = p[P.link_drive] == TORQUE_DRIVE if axis == 0 else p[P.axis_kind + axis] == DYNAMIC
        if driven:
            torque = u[TARGET + axis] if modes[LAGS] == 0 else lagged(p, axis, x, u, after)
            torque = p[P.torque_gain + axis] * torque + p[P.torque_bias + axis]
            if axis == 0:
                u[EXTERNAL] += torque
            else:
                u[axis - 1] = torque + u[BESIDE + axis]


@bare
def servo_bandwidth(p: Array, i: int) -> float:
    """w [rad/s] of servo i, lag included."""
    w = p[P.bandwidth + i]
    return w if p[P.lag] <= 0.0 else w / (1.0 + 0.5 * w * p[P.lag])


@bare
def servo_motion(p: Array, i: int, x: float, v: float, u: float, left: float) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] of servo i, `left` [s] later, under the held command u [rad]."""
    w, limit = servo_bandwidth(p, i), p[P.saturation + 1 + i]
    if limit == inf:
        return servo_step(x, v, u, w, left)
    for _ in range(_PHASES):
        e, b = x - u, v + w * (x - u)
        top = (b + v) / (w * b) if b != 0.0 else 0.0  # when the speed is extreme: -b exp(-w top)
        if abs(v) >= limit and servo_acceleration(x, v, u, w) * v > 0.0:
            v = copysign(limit, v)
            slewing = min((-2.0 * v / w - e) / v, left)  # until the servo asks for no more speed
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
