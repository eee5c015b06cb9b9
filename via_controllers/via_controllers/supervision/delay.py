"""The state of an arm when the torques of a sample will act, a known delay d after its stamp.

    x(t + d) = x(t) + the integral of xd(x, tau) over d,   tau(s) = the torque commanded at the last stamp <= s - d

in Runge-Kutta steps of fourth order under the mean torque, by the model of the controller. Steps are stable: not longer
than 1 / pace of the motors, pace = D / B + (sigma / B)^(1/2), with the damper of the transmission in D. Contacts of the
links are not predicted. An acceleration that is wrong by a makes the angles wrong by a d^2 / 2 and the velocities by
a d: if it is 5 % of that at 30 rad/s, .06 % of the amplitude and .8 % of the largest velocity in 5 ms.
Source: prediction over a dead time; Astrom and Murray, Feedback Systems, Section 10.4.
"""

from __future__ import annotations

from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array

from via_controllers.contract import ArmSample, rounded_down
from via_controllers.supervision.arm_limits import LimitedArm

MOST = 32  # steps of a prediction
NEAR = 1e-6  # [rad], [rad/s] of the differences for the pace
SHARES = (0.0, 0.5, 0.9)  # of the stops at which springs are looked at


class Sent(NamedTuple):
    """A commanded torque (n,) [N m] and the stamp [s] of its sample."""

    stamp: float
    torque: Array


def still_acting(sent: tuple[Sent, ...], stamp: float, delay: float) -> tuple[Sent, ...]:
    """The commands that act after `stamp` [s]: those later than `delay` [s] before it, and the last one before them."""
    acting = [each for each in sent if each.stamp <= stamp - delay]
    return (*acting[-1:], *(each for each in sent if each.stamp > stamp - delay))


def mean_torque(sent: tuple[Sent, ...], begin: float, end: float, delay: float) -> Array | float:
    """Mean torque (n,) [N m] of the time from `begin` to `end` [s]; none before the first of the commands acts."""
    times = [min(max(each.stamp + delay, begin), end) for each in sent]
    shares = ((b - a) / (end - begin) for a, b in pairwise([*times, end]))
    return sum(each.torque * share for each, share in zip(sent, shares, strict=True))


def steps_of(arm: LimitedArm, delay: float) -> int:
    """Number of steps of a prediction over `delay` [s]. Raises ParameterError for more than MOST."""
    zero, fastest = np.zeros(arm.n), 0.0
    for share in SHARES:
        q = np.where(np.isfinite(arm.deflection_limit), share * arm.deflection_limit, 0.0)
        torque = arm.loads(q, zero, zero, zero)[0]
        stiffness = np.abs(arm.loads(q, zero, zero - NEAR, zero)[0] - torque) / NEAR
        damping = np.abs(arm.loads(q, zero, zero, zero - NEAR)[0] - torque) / NEAR + arm.motor_friction
        fastest = max(fastest, float(np.max(damping / arm.motor_inertia + np.sqrt(stiffness / arm.motor_inertia))))
    steps = max(ceil(delay * fastest), 1)
    if steps > MOST:
        longest = rounded_down(MOST / fastest)
        raise ParameterError(f"delay: the motors are too fast to predict {delay:g} s; at most {longest} s")
    return steps


def ahead(arm: LimitedArm, sample: ArmSample, sent: tuple[Sent, ...], delay: float, steps: int = 1) -> ArmSample:
    """The sample `delay` > 0 [s] later, its time included, under the commands `sent` at earlier stamps."""
    stamp, torque = sample.time, mean_torque(sent, sample.time, sample.time + delay, delay)

    def rates(x: Array) -> Array:
        tau_e, acceleration = arm.loads(*x)
        return np.array([x[1], acceleration, x[3], (torque + tau_e - arm.motor_friction * x[3]) / arm.motor_inertia])

    x = np.array([sample.q, sample.q_velocity, sample.theta, sample.theta_velocity])
    before, h = arm.loads(*x)[0], delay / steps
    for _ in range(steps):
        k1 = rates(x)
        k2 = rates(x + 0.5 * h * k1)
        k3 = rates(x + 0.5 * h * k2)
        k4 = rates(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    change = arm.loads(*x)[0] - before
    q, velocity, theta, motor_velocity = x
    return ArmSample(stamp + delay, q, velocity, theta, motor_velocity, sample.spring_torque + change, delay)
