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
at 2 eta / (omega sinh eta), eta = arccosh D.

Source: the document's Section 7, after M. C. Oezparpucu and S. Haddadin, IROS 2013 (its reference [36]).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, acosh, ceil, inf, isfinite, pi, sin, sinh, sqrt

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
