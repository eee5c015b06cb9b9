"""Share of a torque that the angles alone predict, by splines of cross-validated resolution.

A torque that a controller computes from the angle contains information on the controller, not on the joint.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from via_core.signals import Array

from via_gap.logs.log import JointLog

PASSES = 8  # blocks of time, each predicted from the others
KNOTS = (6, 12, 24, 48)  # intervals of the splines over an angle; held-out error decides
LAGS = 6  # samples by which a recorded torque may follow the angle it was computed from
FEWEST = 100  # samples: two per interval of the finest splines
POINTS = 4000  # samples of a regression at most: enough for 48 intervals
RIDGE = 1e-9  # of the largest normal-equation term: intervals without samples
VISITED = 0.5  # least share of samples at angles that other blocks visit as well


def left_by_angles(log: JointLog, tau: Array) -> tuple[float, float, float] | None:
    """Held-out mean squared error of splines over the angles, variance of the torque, and share of samples compared.

    Blocks of time are predicted from the others at angles that these visit as well. None if fewer than half of the
    samples are at such angles.
    """
    angles = [log.measured["q"]]
    if "theta" in log.measured and log.device.n_motors:
        angles += [*log.measured["theta"].T, *(log.measured["q"] - each for each in log.measured["theta"].T)]
    x, y = _shifted(angles, tau, 0)
    if len(y) < FEWEST or np.any(np.ptp(x, axis=0) == 0.0):
        return None
    tried = [(left, knots) for knots in KNOTS if (left := _held_out(x, y, knots)) is not None]
    if not tried:
        return None
    best, knots = min(tried)
    later = [_held_out(*_shifted(angles, tau, lag), knots) for lag in range(1, LAGS)]
    return min([best, *(left for left in later if left is not None)])


def _shifted(angles: list[Array], tau: Array, lag: int) -> tuple[Array, Array]:
    """Some POINTS pairs of angles (n, a) and the torque (n,) `lag` samples later; all if there are fewer."""
    x, y = np.column_stack(angles)[: len(tau) - lag], tau[lag:]
    good = np.flatnonzero(np.isfinite(x).all(axis=1) & np.isfinite(y))
    good = good[:: max(1, len(good) // POINTS)]
    return x[good], y[good]


def _held_out(x: Array, y: Array, knots: int) -> tuple[float, float, float] | None:
    """As `left_by_angles`, with splines of `knots` intervals over each angle."""
    low, high = x.min(axis=0), x.max(axis=0)
    unit = np.clip((x - low) / (high - low), 0.0, 1.0)
    grid = np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, knots + 1), np.ones(3)))
    design = np.hstack([BSpline.design_matrix(column, grid, 3).toarray() for column in unit.T])
    block = np.arange(len(y)) * PASSES // len(y)
    cell = np.minimum((unit[:, 0] * knots).astype(int), knots - 1)
    counted = np.zeros((PASSES, knots))
    np.add.at(counted, (block, cell), 1.0)
    others = counted.sum(axis=0) - counted
    known = others[block, cell] >= 4.0  # a cubic has four coefficients
    if known.mean() < VISITED:
        return None
    errors = np.empty(len(y))
    parts = [design[block == k].T @ design[block == k] for k in range(PASSES)]
    sides = [design[block == k].T @ y[block == k] for k in range(PASSES)]
    whole, side = sum(parts), sum(sides)
    ridge = RIDGE * np.max(np.diag(whole)) * np.eye(len(side))
    for k in range(PASSES):
        left_out = block == k
        fit = np.linalg.solve(whole - parts[k] + ridge, side - sides[k])
        errors[left_out] = y[left_out] - design[left_out] @ fit
    return float(np.mean(errors[known] ** 2)), float(np.var(y[known])), float(known.mean())
