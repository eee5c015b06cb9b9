"""A position drive on the link of a rigid joint: from commanded goal to torque on the link.

    goal g -> dead time -> g + f (kd / kp) dg/dt -> speed limit -> lag -> torque
    torque = s(clip(kp (c(e) + z), limit)) - kd qd                 e = goal - measured
             s(clip(kp (c(e) + z) - kd qd, limit))                 limited: sum
    dz/dt = (ki / kp) e,  |kp z| <= limit of the integral and of the torque

c is the error itself and s the torque itself, or what the terms of the catalogue let through. The integral z is
constant during a tick (or a piece of it, where a command arrives within it), as in a drive that samples: it has its
value in the middle, predicted with the error at the beginning, and advances by the trapezoidal rule. A drive that is
off forgets it. The speed of the goal is its change from command to command over a tick; with the feedforward f = 1, kd
acts on the derivative of the error.

The feedback uses the drive's own encoder, so an encoder error changes the torque as well as the log. kd acts as viscous
friction while the drive is on, which the exponential integrator covers; gain, bias, c, s and z apply to the other
torque only. A drive that is off has no torque, and its goal follows the measured angle. In other drives the lag is
between command and torque; here it acts on the goal, so that it affects the command only and not the feedback.
"""

from __future__ import annotations

from math import copysign, exp, inf

from via_core.signals import Array

from via_sim.joint.compiled import bare
from via_sim.joint.encoders import read_motion
from via_sim.joint.parameters import POSITION_DRIVE, P
from via_sim.joint.terms import corrected, saturated


@bare
def brake_inside(p: Array) -> float:
    """Damping [N m s/rad] inside the limit, before the gain that `drive_damping` contains."""
    if p[P.drive_limits_sum] == 0.0 or p[P.torque_gain] == 0.0:
        return 0.0
    return p[P.drive_damping] / p[P.torque_gain]


@bare
def drive_torque(p: Array, goal: float, held: float, power: float, q: float, w: float) -> float:
    """Torque [N m] of the drive without - kd w, at link angle q [rad] and speed w [rad/s].

    held is the integral [rad]; power is 1 (on), 0 (off) or a mean of these.
    """
    if power == 0.0:
        return 0.0
    measured, _ = read_motion(p, 0, q, 0.0)
    limit, brake = p[P.drive_torque_limit], brake_inside(p) * w
    pull = min(max(p[P.drive_stiffness] * (corrected(p, goal - measured) + held) - brake, -limit), limit)
    pull = saturated(p, 0, pull) + brake
    return power * (p[P.torque_gain] * pull + p[P.torque_bias])


@bare
def integral_reach(p: Array) -> float:
    """Largest integral [rad]."""
    return min(p[P.integral_limit], p[P.drive_torque_limit], p[P.saturation]) / p[P.drive_stiffness]


@bare
def integral_at_start(p: Array) -> float:
    """Integral [rad] at the beginning of a run; 0 without integral action."""
    if p[P.link_drive] != POSITION_DRIVE or p[P.integral_rate] <= 0.0:
        return 0.0
    reach = integral_reach(p)
    return min(max(p[P.integral_start] / p[P.drive_stiffness], -reach), reach)


@bare
def integrated(p: Array, before: float, error: float, width: float) -> float:
    """Integral [rad], `width` [s] later than `before`, under a mean error [rad]."""
    reach = integral_reach(p)
    return min(max(before + p[P.integral_rate] * width * error, -reach), reach)


@bare
def led(p: Array, goal: float, before: float, period: float) -> float:
    """Goal [rad] with its feedforward, of a command `period` [s] after the one with the goal `before`."""
    return goal + p[P.feedforward] * p[P.drive_damping] / p[P.drive_stiffness] * (goal - before) / period


@bare
def followed(p: Array, commanded: float, followed_before: float, after: float) -> float:
    """Goal [rad] behind the speed limit, `after` [s] later than `followed_before`, under a constant command."""
    if p[P.drive_speed_limit] == inf:
        return commanded
    way, reach = commanded - followed_before, p[P.drive_speed_limit] * after
    return commanded if abs(way) <= reach else followed_before + copysign(reach, way)


@bare
def acting_goal(p: Array, commanded: float, followed_before: float, lagged_before: float, after: float) -> float:
    """Goal [rad] behind speed limit and lag, `after` [s] later than `followed_before` and `lagged_before`.

    T y' = u - y under a ramp u of slope r is y = u - r T + (y(0) - u(0) + r T) exp(-t/T).
    """
    lag, way, speed = p[P.lag], commanded - followed_before, p[P.drive_speed_limit]
    ramp = min(abs(way) / speed, after)  # [s] while the goal moves
    goal = followed(p, commanded, followed_before, after)
    if lag <= 0.0:
        return goal
    behind = lagged_before - (followed_before if ramp > 0.0 else goal)
    if ramp > 0.0:
        trail = copysign(speed * lag, way)
        behind = (behind + trail) * exp(-ramp / lag) - trail
    return goal + behind * exp(-(after - ramp) / lag)


@bare
def mean_followed(p: Array, commanded: float, followed_before: float, width: float) -> float:
    """Mean [rad] of `followed` over the next `width` [s]."""
    way, speed = commanded - followed_before, p[P.drive_speed_limit]
    ramp = min(abs(way) / speed, width)
    if ramp <= 0.0 or width <= 0.0:
        return followed(p, commanded, followed_before, width)
    return followed_before + copysign(speed * ramp, way) * (1.0 - 0.5 * ramp / width)
