"""Link over motor velocity of Section 7 in closed form: at the reversal times t_n, and with other reversals.

With D the damping ratio, beta = arccos D, c = cot(beta), E_0 = exp(-2 beta c), r = exp(-pi c), and t_n of
`via_controllers.joints.visco_elastic`

    epsilon(n, D) = max qd(t_n) / v = 1 + E_0 + E_0 (1 + r) (1 - r^n) / (1 - r),   epsilon(n, 0) = 2 (n + 1)

Source: the document's Section 7.
"""

from __future__ import annotations

from math import acosh, atan2, cos, cosh, exp, expm1, inf, pi, sin, sinh, sqrt

import numpy as np
from via_controllers.contract import require
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_core.signals import Array


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


def velocity_with(joint: ViscoElasticJoint, turns: Array, horizon: float) -> float:
    """qd(t_f) / v [-] if the motor, +v at the end, reverses at `turns` (n,) [s] after the start instead."""
    ends = np.concatenate([[0.0], np.sort(horizon - np.asarray(turns))[: len(turns)], [horizon]])
    signs = np.where(np.arange(len(ends) - 1) % 2, -1.0, 1.0)
    return float(signs @ np.diff(joint.step_response(ends)))
