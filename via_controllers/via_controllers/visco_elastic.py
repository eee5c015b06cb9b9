"""Largest link velocity of a visco-elastic joint with commanded motor velocity: Section 7, in closed form.

    M qdd = K (theta - q) + 2 D omega M (thetad - qd),   |thetad| <= v,   omega = sqrt(K / M),   all at rest at t = 0

The link's velocity is linear in the motor's, qd(t_f) = integral of g(t_f - xi) thetad(xi) dxi: eq. (125) with the
switching function sigma*(xi) = -g(t_f - xi). With beta = arccos D and omega_d = omega sin(beta)

    g(t) = omega exp(-D omega t) sin(2 beta - omega_d t) / sin(beta)

so that max qd(t_f) = v integral of |g| over [0, t_f], reached by thetad(xi) = v sign g(t_f - xi). The motor
reverses at these times before t_f:

    t_k = (2 beta + k pi) / omega_d,   k = 0, 1, ...

The time between two reversals is pi / omega_d. With damping the last interval, 2 beta / omega_d, is shorter: reversing
every pi / omega_d is not optimal. With critical damping there is one reversal, at 2 / omega; with stronger damping one,
at 2 eta / (omega sinh eta), eta = arccosh D. With c = cot(beta), E_0 = exp(-2 beta c),
r = exp(-pi c)

    epsilon(n, D) = max qd(t_n) / v = 1 + E_0 + E_0 (1 + r) (1 - r^n) / (1 - r),   epsilon(n, 0) = 2 (n + 1)

Source: the document's Section 7, after M. C. Oezparpucu and S. Haddadin, IROS 2013 (its reference [36]).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, acosh, atan2, ceil, cos, cosh, exp, expm1, inf, isfinite, pi, sin, sinh, sqrt

import numpy as np
from via_core.signals import Array

from via_controllers.contract import require


@dataclass(frozen=True)
class ViscoElasticJoint:
    """The joint model. Raises ParameterError for a frequency <= 0 or a negative damping ratio."""

    frequency: float  # omega [rad/s], undamped
    damping_ratio: float  # D [-]

    def __post_init__(self) -> None:
        omega, D = self.frequency, self.damping_ratio
        require(isfinite(omega) and omega > 0.0, f"frequency must be > 0 rad/s, got {omega}")
        require(isfinite(D) and D >= 0.0, f"damping_ratio must be >= 0, got {D}")

    @property
    def first_turn(self) -> float:
        """t_0 [s], time from the last reversal of the motor to the end."""
        omega, D = self.frequency, self.damping_ratio
        if D < 1.0:
            beta = acos(D)
            return 2.0 * beta / (omega * sin(beta)) if beta > 0.0 else 2.0 / omega
        eta = acosh(D)
        return 2.0 / omega * (eta / sinh(eta) if eta > 0.0 else 1.0)

    @property
    def between_turns(self) -> float:
        """Time between reversals, pi / omega_d [s]; infinite from critical damping on."""
        D = self.damping_ratio
        return pi / (self.frequency * sqrt((1.0 - D) * (1.0 + D))) if D < 1.0 else inf

    def turns(self, horizon: float) -> Array:
        """Times (n,) [s] after the start, rising, at which the motor reverses before t_f = `horizon` [s]."""
        if horizon <= self.first_turn:
            return np.zeros(0)
        more = 0 if self.between_turns == inf else ceil((horizon - self.first_turn) / self.between_turns) - 1
        back = self.first_turn + (np.arange(more + 1) * self.between_turns if more else np.zeros(1))
        return np.asarray(horizon - back[::-1], dtype=float)

    def motor_velocity(self, time: float, horizon: float) -> float:
        """thetad / v at `time` [s] since the start: +-1 in [0, horizon) [s], 0 outside."""
        if not 0.0 <= time < horizon:
            return 0.0
        left = int(np.count_nonzero(self.turns(horizon) > time))
        return -1.0 if left % 2 else 1.0

    def response(self, time: Array) -> Array:
        """g(t) [1/s], shape of `time` [s] >= 0: response of the link velocity to a unit impulse of motor velocity."""
        t, omega, D = np.asarray(time, dtype=float), self.frequency, self.damping_ratio
        a = omega * t
        if D < 1.0:
            rate = sqrt((1.0 - D) * (1.0 + D))
            # sinc has the limit of sin(rate a) / rate for rate 0.
            share = a * np.sinc(rate * a / pi)
            value = np.exp(-D * a) * (2.0 * D * np.cos(rate * a) + (1.0 - 2.0 * D * D) * share)
        else:
            # Decaying exponentials cannot overflow.
            rate = sqrt((D - 1.0) * (D + 1.0))
            slow, fast = np.exp(-a / (D + rate)), np.exp(-(D + rate) * a)
            share = 0.5 * (slow - fast) / rate if rate > 1e-6 else a * np.exp(-D * a)
            value = D * (slow + fast) + (1.0 - 2.0 * D * D) * share
        return omega * value

    def step_response(self, time: Array) -> Array:
        """Integral of g over [0, t] [-], shape of `time` [s]: step response of the link velocity to the motor's."""
        t, omega, D = np.asarray(time, dtype=float), self.frequency, self.damping_ratio
        a = omega * t
        if D < 1.0:
            rate = sqrt((1.0 - D) * (1.0 + D))
            return 1.0 - np.exp(-D * a) * (np.cos(rate * a) - D * a * np.sinc(rate * a / pi))
        rate = sqrt((D - 1.0) * (D + 1.0))
        slow, fast = np.exp(-a / (D + rate)), np.exp(-(D + rate) * a)
        share = 0.5 * (slow - fast) / rate if rate > 1e-6 else a * np.exp(-D * a)
        return 1.0 - 0.5 * (slow + fast) + D * share

    def fastest(self, horizon: float) -> float:
        """max qd(t_f) / v [-] for t_f = `horizon` [s] >= 0: integral of |g| over [0, t_f]."""
        require(horizon >= 0.0, f"a horizon must be >= 0 s, got {horizon}")
        ends = np.concatenate([[0.0], (horizon - self.turns(horizon))[::-1], [horizon]])
        return float(np.abs(np.diff(self.step_response(ends))).sum())

    def velocity_with(self, turns: Array, horizon: float) -> float:
        """qd(t_f) / v [-] if the motor, +v at the end, reverses at `turns` (n,) [s] after the start instead."""
        ends = np.concatenate([[0.0], np.sort(horizon - np.asarray(turns))[: len(turns)], [horizon]])
        signs = np.where(np.arange(len(ends) - 1) % 2, -1.0, 1.0)
        return float(signs @ np.diff(self.step_response(ends)))


def performance(turns: int, damping_ratio: float) -> float:
    """epsilon(n, D) [-]: link over motor velocity with t_f = t_n, after n = `turns` >= 0 reversals of the motor.

    From critical damping on there is at most one reversal, and t_n does not exist for n > 0: the supremum over t_f.
    """
    require(turns >= 0, f"a number of turns must be >= 0, got {turns}")
    require(damping_ratio >= 0.0, f"damping_ratio must be >= 0, got {damping_ratio}")
    D = damping_ratio
    if D >= 1.0:
        return 1.0 + _first(D) if turns == 0 else 1.0 + 2.0 * _first(D)
    c = D / sqrt((1.0 - D) * (1.0 + D))
    # (1 + r) (1 - r^n) / (1 - r) with r = exp(-pi c); 2 n where r = 1
    swings = -expm1(-turns * pi * c) * (1.0 + exp(-pi * c)) / -expm1(-pi * c) if c > 0.0 else 2.0 * turns
    return 1.0 + _first(D) * (1.0 + swings)


def bound(damping_ratio: float) -> float:
    """epsilon(inf, D) [-], the bound for any t_f; infinite without damping."""
    require(damping_ratio >= 0.0, f"damping_ratio must be >= 0, got {damping_ratio}")
    D = damping_ratio
    if D == 0.0:
        return inf
    if D >= 1.0:
        return 1.0 + 2.0 * _first(D)
    return 1.0 - 2.0 * _first(D) / expm1(-pi * D / sqrt((1.0 - D) * (1.0 + D)))


def _first(D: float) -> float:
    """E_0: excess of the link velocity over the motor velocity, over v, after the first half swing."""
    if D < 1.0:
        beta = atan2(sqrt((1.0 - D) * (1.0 + D)), D)
        return exp(-2.0 * beta * cos(beta) / sin(beta)) if beta > 0.0 else exp(-2.0)
    eta = acosh(D)
    return exp(-2.0 * eta * cosh(eta) / sinh(eta)) if eta > 0.0 else exp(-2.0)
