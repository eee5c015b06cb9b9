"""A position drive on the link of a rigid joint: from commanded goal to torque on the link.

    goal -> dead time -> speed limit -> lag -> clip(kp c(goal - measured), limits) -> gain, bias -> link; - kd qd
                                               clip(kp c(goal - measured) - kd qd, limits) + kd qd    limited: sum

c is the error itself, or what the terms of the catalogue let through. The feedback uses the drive's own encoder, so an
encoder error changes the torque as well as the log. kd acts as viscous friction while the drive is on, which the
exponential integrator covers; gain, bias, saturation and c apply to the other torque only. A drive that is off has no
torque, and its goal follows the measured angle. In other drives the lag is between command and torque; here it acts on
the goal, so that it affects the command only and not the feedback.
"""

from __future__ import annotations

from math import copysign, exp, inf

from via_core.signals import Array

from via_sim.joint.compiled import bare
from via_sim.joint.encoders import read_motion
from via_sim.joint.parameters import P
from via_sim.joint.terms import corrected


@bare
def brake_inside(p: Array) -> float:
    """Damping [N m s/rad] inside the limit, before the gain that `drive_damping` contains."""
    if p[P.drive_limits_sum] == 0.0 or p[P.torque_gain] == 0.0:
        return 0.0
    return p[P.drive_damping] / p[P.torque_gain]


@bare
def drive_torque(p: Array, goal: float, power: float, q: float, w: float) -> float:
    """Torque [N m] of the drive without - kd w, at link angle q [rad] and speed w [rad/s].

    power is 1 (on), 0 (off) or a mean of these.
    """
    if power == 0.0:
        return 0.0
    measured, _ = read_motion(p, 0, q, 0.0)
    limit, brake = min(p[P.drive_torque_limit], p[P.saturation]), brake_inside(p) * w
    pull = min(max(p[P.drive_stiffness] * corrected(p, goal - measured) - brake, -limit), limit) + brake
    return power * (p[P.torque_gain] * pull + p[P.torque_bias])


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
