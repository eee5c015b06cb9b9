"""Checks that the samples of an arm can be its motion, before anything is computed from them.

    values        finite, angles up to FURTHEST, speeds up to FASTEST
    deflections   |q - theta| up to BEYOND times the stop of the spring: other units, a turn lost, encoders not zeroed
    velocities    their integral follows the angles: drivers often publish zeros, or another unit

The difference between an angle and the integral of its velocity fades with the time constant FADES, so that neither a
bias nor the lag of a filter counts. Until a wrong velocity is found, limits must hold with it. They get the faster of
two: the measured one, and one whose changes within CORRECTED are measured and whose slower part is that of the angle (a
complementary filter).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from via_core.signals import Array

from via_controllers.contract import ArmSample
from via_controllers.supervision.arm_limits import LimitedArm

FURTHEST, FASTEST = 1e2, 1e3  # [rad], [rad/s]
BEYOND = 2.0  # stops: no impact deflects a spring that far, degrees and lost turns do
CORRECTED = 0.005  # [s]: an encoder of 14 bits at 1 kHz adds noise of .01 rad/s
FADES, DIFFERENT = 0.5, 0.2  # [s], [rad]: a filter that lags by 20 ms differs by as much at 10 rad/s
IMPOSSIBLE = "unusable samples: a value is missing or impossible"
DEFLECTED = (
    "unusable samples: a spring is deflected beyond twice its stop: check unit, sign and zero of the encoders, and "
    "lost turns"
)
VELOCITIES = (
    "unusable samples: velocities do not fit the angles: check that the driver publishes them, their unit and sign"
)


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """The last usable sample, and how its velocities differ from its angles; links first, then motors.

    apart   (2, n) [rad] angles minus integrated velocities
    lacking (2, n) [rad/s] what the velocities lack
    """

    sample: ArmSample
    apart: Array
    lacking: Array

    @staticmethod
    def of(sample: ArmSample) -> MeasuredMotion:
        """The motion that begins with `sample`."""
        return MeasuredMotion(sample, *np.zeros((2, 2, len(sample.q))))

    @property
    def corrected(self) -> ArmSample:
        """The sample with the velocities that limits need: measured or corrected ones, whichever are faster."""
        now, (links, motors) = self.sample, self.lacking
        links, motors = _faster(now.q_velocity, links), _faster(now.theta_velocity, motors)
        return ArmSample(now.time, now.q, links, now.theta, motors, now.spring_torque)

    def next(self, sample: ArmSample, longest: float) -> tuple[MeasuredMotion, str]:
        """The next state, and what is wrong with the velocities of `sample`; anew after `longest` [s]."""
        step, last = sample.time - self.sample.time, self.sample
        if not 0.0 < step <= longest:
            return self.of(sample), ""
        apart, lacking = self.apart.copy(), self.lacking.copy()
        _compare(apart[0], lacking[0], step, last.q, sample.q, last.q_velocity, sample.q_velocity)
        _compare(apart[1], lacking[1], step, last.theta, sample.theta, last.theta_velocity, sample.theta_velocity)
        return MeasuredMotion(sample, apart, lacking), VELOCITIES if np.abs(apart).max() > DIFFERENT else ""


def fault_of(sample: ArmSample, arm: LimitedArm) -> str:
    """What is wrong with the values of a sample; empty: nothing."""
    if not _possible(sample.time, sample.q, sample.theta, sample.q_velocity, sample.theta_velocity):
        return IMPOSSIBLE
    return "" if _within(sample.q, sample.theta, arm.deflection_limit) else DEFLECTED


@njit(cache=True, error_model="numpy")
def _possible(time: float, q: Array, theta: Array, q_velocity: Array, theta_velocity: Array) -> bool:
    possible = np.isfinite(time)
    for i in range(q.size):
        possible &= abs(q[i]) <= FURTHEST and abs(theta[i]) <= FURTHEST
        possible &= abs(q_velocity[i]) <= FASTEST and abs(theta_velocity[i]) <= FASTEST
    return bool(possible)


@njit(cache=True, error_model="numpy")
def _within(q: Array, theta: Array, stop: Array) -> bool:
    within = True
    for i in range(q.size):
        within &= abs(q[i] - theta[i]) <= BEYOND * stop[i]
    return within


@njit(cache=True, error_model="numpy")
def _compare(
    apart: Array, lacking: Array, step: float, before: Array, now: Array, last: Array, velocity: Array
) -> None:
    for i in range(apart.size):
        moved = now[i] - before[i] - 0.5 * step * (last[i] + velocity[i])
        apart[i] = (apart[i] + moved) / (1.0 + step / FADES)
        lacking[i] += (moved - step * lacking[i]) / (CORRECTED + step)


@njit(cache=True, error_model="numpy")
def _faster(measured: Array, lacking: Array) -> Array:
    out = measured.copy()
    for i in range(out.size):
        if abs(measured[i] + lacking[i]) > abs(measured[i]):
            out[i] = measured[i] + lacking[i]
    return out
