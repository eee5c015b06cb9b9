"""What the equations of a joint need of the cell about a sample: shifted angles, mean friction, mean goal of a drive.

The cell of a sample reaches halfway to its neighbours. Commands are held over it, and friction may change its sign.
"""

from __future__ import annotations

from math import exp, isfinite

from via_core.signals import Array
from via_sim.joint.compiled import bare
from via_sim.joint.friction import dry_friction
from via_sim.joint.layout import GOAL, POWER, U, X
from via_sim.joint.measurements import hermite
from via_sim.joint.parameters import P
from via_sim.joint.position_drive import followed, mean_followed


@bare
def ahead(time: Array, angle: Array, velocity: Array, axis: int, n: int, skew: float) -> tuple[float, float]:
    """Measured angle and velocity of an axis `skew` [s] after sample n, interpolated."""
    when, k, last = time[n] + skew, n, time.size - 1
    while k < last - 1 and time[k + 1] < when:
        k += 1
    if k == last or time[last] < when:
        return angle[last, axis] + (when - time[last]) * velocity[last, axis], velocity[last, axis]
    h = time[k + 1] - time[k]
    a, b = angle[k, axis], angle[k + 1, axis]
    return hermite(a, velocity[k, axis], b, velocity[k + 1, axis], h, (when - time[k]) / h)


@bare
def slipping_friction(
    p: Array, axis: int, before: float, speed: float, after: float, load: float, counter: float
) -> float:
    """Mean dry friction [N m] on a slipping axis over a cell in which the velocity may change its sign."""
    swing = 0.25 * abs(after - before)  # change of velocity over half a cell
    if isfinite(swing) and abs(speed) < swing:
        forwards = 0.5 * (1.0 + speed / swing)
    else:
        forwards = 1.0 if speed > 0.0 else (0.0 if speed < 0.0 else 0.5)
    friction = 0.0
    if forwards > 0.0:
        friction += forwards * dry_friction(p, axis, 1, abs(speed), load, counter)
    if forwards < 1.0:
        friction -= (1.0 - forwards) * dry_friction(p, axis, -1, abs(speed), load, counter)
    return friction


@bare
def mean_goal(p: Array, late: Array, measured: float, width: float, x: Array, u: Array) -> None:
    """Mean goal of a position drive over a cell of `width` [s], and the share of time that the drive is on, into u.

    late (N_COMMANDS,): means of the commands; measured [rad]: goal of a drive that is off. x holds the goal behind the
    speed limit and behind the lag, here both absolute [rad].
    """
    u[U.on] = late[POWER]
    if u[U.on] <= 0.0:
        x[X.behind] = x[X.lag] = u[U.acting] = measured
        return
    commanded = late[GOAL] / u[U.on]
    u[U.acting] = mean_followed(p, commanded, x[X.behind], width)
    x[X.behind] = followed(p, commanded, x[X.behind], width)
    if p[P.lag] > 0.0:
        passed = u[U.acting] + (x[X.lag] - u[U.acting]) * exp(-width / p[P.lag])
        if width > 0.0:
            u[U.acting] -= p[P.lag] * (passed - x[X.lag]) / width
        x[X.lag] = passed
