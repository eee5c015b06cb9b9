"""The VSA-II in the tests of Section 4: motion, and its signals from ideal and real sensors.

Equations (4), (5) with the springs (50), (51), where spring 1 drifts. The simulator has no time-dependent springs, so
scipy's DOP853 integrates the motion here. The torques are continuous. A measured torque is the mean over the interval
that ends at its stamp, as the estimators assume.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi, sin

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from via_core.device_parts import TorqueMotor
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_core.spring_equations import spring_stiffness, spring_torque
from via_core.springs import OddPolynomialSpring, SpringLaw

VARIANTS = {"v1": "vsa2", "v2": "vsa2_v2", "v3": "vsa2_v3"}  # links: (C, M, m g d) are not printed; chosen
INERTIA, DAMPING = 7.5e-3, 0.9e-3  # true B_A [kg m^2], D_A [N m s/rad]; device files have the nominal ones
AMPLITUDE, TONES = 0.05, (0.1 * pi, 2.0 * pi)  # [N m], [rad/s] of motor 1 and 2
SLOW, FAST = 5e-7, 5e-4  # drift of spring 1 [N m/rad/s]: .0005 as printed and .5, in N mm/rad per second
QUANTUM = 2.0 * pi / 2**14  # [rad]
TORQUE_NOISE = 1e-3  # [N m]
PERIOD, DURATION = 1e-3, 20.0  # [s]


@dataclass(frozen=True)
class Motion:
    """A run without noise; N samples."""

    time: Array  # (N,) [s]
    q: Array  # (N,) [rad]
    theta: Array  # (N, 2) [rad]
    theta_velocity: Array  # (N, 2) [rad/s]
    tau: Array  # (N, 2) [N m] mean over the interval that ends at the stamp
    stiffness_each: Array  # (N, 2) [N m/rad] true

    @property
    def stiffness(self) -> Array:
        """(N,) [N m/rad] of the device."""
        return self.stiffness_each.sum(axis=1)

    def ideal(self) -> Array:
        """Rows (N, 5) of transmission 1 for a method with a velocity sensor: t, q, theta, its velocity, tau."""
        return np.column_stack([self.time, self.q, self.theta[:, 0], self.theta_velocity[:, 0], self.tau[:, 0]])

    def rows(self) -> Array:
        """Rows (N, 6) for a method without one: t, q, theta_1, tau_1, theta_2, tau_2."""
        return np.column_stack([self.time, self.q, self.theta[:, 0], self.tau[:, 0], self.theta[:, 1], self.tau[:, 1]])

    def noisy(self, seed: int) -> Array:
        """`rows` with 14 bit encoders of random zero within a quantum, and white noise on the torques."""
        rng, rows = np.random.default_rng(seed), self.rows()
        zero = rng.uniform(-0.5, 0.5, size=3)
        rows[:, (1, 2, 4)] = QUANTUM * (np.round(rows[:, (1, 2, 4)] / QUANTUM + zero) - zero)
        rows[:, (3, 5)] += TORQUE_NOISE * rng.normal(size=(len(rows), 2))
        return rows


@cache
def motion(variant: str, drift: float = SLOW, terms: int = 0) -> Motion:
    """20 s from rest at the lower equilibrium.

    variant  key of VARIANTS
    drift    of spring 1 [N m/rad/s]
    terms    0: the linkage (50); else springs with that many odd powers, fitted to it over .9 rad
    """
    device = load_device(VARIANTS[variant])
    spring = device.springs[0] if terms == 0 else _fitted(device.springs[0], terms)
    kind, row, link = spring.kind, spring.coefficients(), device.link
    rate = drift / row[0]  # of the spring's factor k

    def grown(t: float) -> float:
        return 1.0 + rate * t

    def rates(t: float, x: Array) -> list[float]:
        q, v, a, av, b, bv = x
        first = grown(t) * spring_torque(kind, row, q - a, 0.0)
        second = spring_torque(kind, row, q - b, 0.0)
        pull = link.viscous_friction * v + link.gravity_torque * sin(q - link.gravity_angle)
        return [
            v, (-pull - first - second) / link.inertia,
            av, (AMPLITUDE * sin(TONES[0] * t) - DAMPING * av + first) / INERTIA,
            bv, (AMPLITUDE * sin(TONES[1] * t) - DAMPING * bv + second) / INERTIA,
        ]  # fmt: skip

    t = PERIOD * np.arange(round(DURATION / PERIOD) + 1, dtype=np.float64)
    x = solve_ivp(rates, (0.0, DURATION), np.zeros(6), "DOP853", t, rtol=1e-11, atol=1e-13, max_step=0.01).y
    integrals = np.stack([AMPLITUDE * (1.0 - np.cos(w * t)) / w for w in TONES], axis=1)
    tau = np.diff(integrals, axis=0, prepend=np.zeros((1, 2))) / PERIOD
    sigma = np.array(
        [[grown(s) * spring_stiffness(kind, row, q - a, 0.0), spring_stiffness(kind, row, q - b, 0.0)]
         for s, q, a, b in zip(t, x[0], x[2], x[4], strict=True)]
    )  # fmt: skip
    return Motion(t, x[0], x[[2, 4]].T, x[[3, 5]].T, tau, sigma)


def _fitted(spring: SpringLaw, terms: int) -> OddPolynomialSpring:
    """Polynomial with `terms` odd powers, fitted to the spring's torque over .9 rad."""
    phi = np.linspace(0.0, 0.9, 200)
    powers = phi[:, None] ** (2 * np.arange(terms) + 1)
    return OddPolynomialSpring(spring.max_deflection, tuple(np.linalg.lstsq(powers, spring.torque(phi), rcond=None)[0]))


def held(variant: str, start: float = 8.0, hold: float = 7.0, slowing: float = 0.2) -> Motion:
    """The motion up to `start` [s], slowed down with the time constant `slowing` [s], until `hold` [s] later.

    Angles follow the free motion on a clock that stops; the torque of motor 1 follows from the motor equation. The
    torque of motor 2 is not adapted: only transmission 1 is evaluated.
    """
    free = motion(variant)
    device: Device = load_device(VARIANTS[variant])
    spring = device.springs[0]
    angle, link = CubicSpline(free.time, free.theta, axis=0), CubicSpline(free.time, free.q)
    t = PERIOD * np.arange(round((start + hold) / PERIOD) + 1, dtype=np.float64)

    def state(t: Array) -> tuple[Array, Array, Array, Array, Array]:
        later = np.maximum(t - start, 0.0)
        clock = np.minimum(t, start) + slowing * (1.0 - np.exp(-later / slowing))
        rush = np.exp(-later / slowing)
        slow = np.where(t > start, -rush / slowing, 0.0)
        theta, rate = angle(clock), angle(clock, 1) * rush[:, None]
        bend = angle(clock, 2)[:, 0] * rush**2 + angle(clock, 1)[:, 0] * slow
        q = link(clock)
        torque = (
            INERTIA * bend
            + DAMPING * rate[:, 0]
            - (1.0 + SLOW / spring.coefficients()[0] * clock) * spring.torque(q - theta[:, 0])
        )
        return q, theta, rate, torque, clock

    q, theta, rate, _, clock = state(t)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    tau = np.tile(
        sum(0.5 * w * state(t + 0.5 * PERIOD * (node - 1.0))[3] for node, w in zip(nodes, weights, strict=True)), (2, 1)
    ).T
    sigma = spring.stiffness(q[:, None] - theta)
    sigma[:, 0] *= 1.0 + SLOW / spring.coefficients()[0] * clock
    return Motion(t, q, theta, rate, tau, sigma)


def nominal(variant: str) -> TorqueMotor:
    """The nominal motor, for methods that need a model of it."""
    motor = load_device(VARIANTS[variant]).motors[0]
    assert isinstance(motor, TorqueMotor)
    return motor
