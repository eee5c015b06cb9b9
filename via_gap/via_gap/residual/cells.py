"""What the equations of a joint need of the cell about a sample: shifted angles, mean friction, mean goal of a drive.

The cell of a sample reaches halfway to its neighbours. Commands are constant in it, and friction may change its sign.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from via_core.signals import Array
from via_sim.joint.compiled import bare
from via_sim.joint.friction import dry_friction
from via_sim.joint.layout import GOAL, POWER, U, X
from via_sim.joint.measurements import hermite
from via_sim.joint.parameters import P
from via_sim.joint.position_drive import acting_goal, followed, integral_at_start, integrated, led, mean_followed


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
def first_goal(p: Array, late: Array, measured: float, x: Array) -> None:
    """Goal (absolute, `measured` while the drive is off) and integral of a position drive when a record begins.

    late  (N_COMMANDS,) means over the first cell
    """
    x[X.behind] = x[X.lag] = late[GOAL] / late[POWER] if late[POWER] > 0.0 else measured
    x[X.integral] = integral_at_start(p)


@bare
def mean_goal(p: Array, sent: Any, at: Any, begin: float, width: float, measured: float, x: Array, u: Array) -> None:
    """Mean goal and integral of a position drive over a cell, while it is on, and the share of time it is on, into u.

    sent      times (K,) [s] and commands (K, N_COMMANDS), each constant until the next
    at        (1,) the command at which the last cell ended
    begin     [s] of the cell, `width` [s] long
    measured  [rad] goal of a drive that is off

    x holds the goal behind the speed limit and behind the lag, here both absolute [rad], and the integral.
    """
    times, commands = sent
    last, now = times.size - 1, begin - p[P.delay]
    end = now + width
    on = goal = held = 0.0
    while True:
        while at[0] < last and times[at[0] + 1] <= now:
            at[0] += 1
        span = end - now if at[0] == last else min(times[at[0] + 1], end) - now
        rising = times[at[0]] + width - now  # [s] for which the change to this command lasts, one period
        if 0.0 < rising < span and p[P.feedforward] != 0.0:
            span = rising
        share = span / width if width > 0.0 else 1.0
        if commands[at[0], POWER] > 0.5:
            commanded, follows, lags = commands[at[0], GOAL], x[X.behind], x[X.lag]
            if rising > 0.0 and at[0] > 0 and commands[at[0] - 1, POWER] > 0.5:
                commanded = led(p, commanded, commands[at[0] - 1, GOAL], width)
            x[X.behind] = followed(p, commanded, follows, span)
            x[X.lag] = acting_goal(p, commanded, follows, lags, span)
            mean = mean_followed(p, commanded, follows, span)
            if span > 0.0:
                mean -= p[P.lag] * (x[X.lag] - lags) / span  # T y' = u - y
            error = mean - measured
            on, goal = on + share, goal + share * mean
            held += share * integrated(p, x[X.integral], error, 0.5 * span)
            x[X.integral] = integrated(p, x[X.integral], error, span)
        else:
            x[X.behind] = x[X.lag] = measured
            x[X.integral] = 0.0
        now += span
        if now >= end or width <= 0.0:
            break
    u[U.on], u[U.acting], u[U.held] = on, measured, 0.0
    if on > 0.0:
        u[U.acting], u[U.held] = goal / on, held / on
