"""A position drive on the link of a rigid joint: from the goal that is commanded to the torque on the link.

    goal -> dead time -> speed limit -> lag -> clip(kp (goal - reading), limits) -> gain, bias -> link;  - kd qd -> link

The drive closes its loop over its own encoder, so that an error of that encoder bends the torque as well as the log.
kd counts as viscous friction while the drive is on (the integrator's exponential covers it); what is said of a drive's
torque (gain, bias, saturation) is said of the rest. A drive that is switched off gives no torque; its goal then waits
at the angle that the encoder reads. The lag of other drives, between command and torque, is here one of the goal: only
so does it act in the path of the command alone.
"""

from __future__ import annotations

from math import copysign, exp, inf

from via_core.signals import Array

from via_sim.compiled import bare
from via_sim.encoders import read_motion
from via_sim.parameters import P


@bare
def drive_torque(p: Array, goal: float, power: float, q: float) -> float:
    """Torque [N m] of the drive but for kd at link angle q [rad]; power: 1 on, 0 off, between: share of a mean."""
    if power == 0.0:
        return 0.0
    reading, _ = read_motion(p, 0, q, 0.0)
    limit = min(p[P.drive_torque_limit], p[P.saturation])
    pull = min(max(p[P.drive_stiffness] * (goal - reading), -limit), limit)
    return power * (p[P.torque_gain] * pull + p[P.torque_bias])


@bare
def followed(p: Array, asked: float, followed_before: float, after: float) -> float:
    """Goal [rad] behind the speed limit, `after` [s] it stood at `followed_before`, under a held command."""
    if p[P.drive_speed_limit] == inf:
        return asked
    way, reach = asked - followed_before, p[P.drive_speed_limit] * after
    return asked if abs(way) <= reach else followed_before + copysign(reach, way)


@bare
def acting_goal(p: Array, asked: float, followed_before: float, lagged_before: float, after: float) -> float:
    """Goal [rad] behind speed limit and lag, `after` [s] these stood at `followed_before` and `lagged_before`.

    T y' = u - y under a ramp u of slope r is y = u - r T + (y(0) - u(0) + r T) exp(-t/T).
    """
    lag, way, speed = p[P.lag], asked - followed_before, p[P.drive_speed_limit]
    ramp = min(abs(way) / speed, after)  # [s] for which the goal moves
    goal = followed(p, asked, followed_before, after)
    if lag <= 0.0:
        return goal
    behind = lagged_before - (followed_before if ramp > 0.0 else goal)
    if ramp > 0.0:
        trail = copysign(speed * lag, way)
        behind = (behind + trail) * exp(-ramp / lag) - trail
    return goal + behind * exp(-(after - ramp) / lag)


@bare
def mean_followed(p: Array, asked: float, followed_before: float, width: float) -> float:
    """Mean [rad] of `followed` over `width` [s] from then on."""
    way, speed = asked - followed_before, p[P.drive_speed_limit]
    ramp = min(abs(way) / speed, width)
    if ramp <= 0.0 or width <= 0.0:
        return followed(p, asked, followed_before, width)
    return followed_before + copysign(speed * ramp, way) * (1.0 - 0.5 * ramp / width)
